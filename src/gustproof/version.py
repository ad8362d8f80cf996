"""Version of the project, and of the software that flies."""

__version__ = "0.1.0"
_PACKAGES = ("numpy", "scipy", "numba", "llvmlite", "pymavlink")
_versions: dict[str, str] = {}


def software_versions() -> dict[str, str]:
    """Return the versions of everything that can change the bits of a flight or a campaign."""
    if not _versions:
        import platform
        from importlib.metadata import version

        _versions.update(gustproof=__version__, python=platform.python_version(), machine=platform.machine())
        _versions.update((name, version(name)) for name in _PACKAGES)
    return _versions
