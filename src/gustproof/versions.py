"""Versions of the software that flies."""

import platform
from functools import cache
from importlib.metadata import version

from gustproof import __version__

_PACKAGES = ("numpy", "scipy", "numba", "llvmlite", "pymavlink")


@cache
def software_versions() -> dict[str, str]:
    """Return the versions of everything that can change the bits of a flight or a campaign."""
    return {
        "gustproof": __version__,
        "python": platform.python_version(),
        "machine": platform.machine(),
        **{name: version(name) for name in _PACKAGES},
    }
