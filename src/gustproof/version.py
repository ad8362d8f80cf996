"""Version of the project, and of the software that flies."""

from functools import cache

__version__ = "0.1.0"
_PACKAGES = ("numpy", "scipy", "numba", "llvmlite", "pymavlink")


@cache
def software_versions() -> dict[str, str]:
    """Return the versions of everything that can change the bits of a flight or a campaign."""
    import platform
    from importlib.metadata import version

    return {
        "gustproof": __version__,
        "python": platform.python_version(),
        "machine": platform.machine(),
        **{name: version(name) for name in _PACKAGES},
    }
