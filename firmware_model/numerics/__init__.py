"""Compute the same bits on every route, with compiled arithmetic."""

import sys
from importlib import import_module
from pathlib import Path


def _import_numba() -> None:
    """Import numba without packages that it tries and does not need, which take a tenth of each start.

    It looks at `coverage` for a mode of its own that nobody switches on here, and at `yaml` for a file of settings.
    """
    absent = {"coverage", "yaml"} - set(sys.modules)
    if Path(".numba_config.yaml").exists():
        absent.discard("yaml")
    sys.modules.update(dict.fromkeys(absent))  # type: ignore[arg-type]  # `None` means that there is no such module
    try:
        import_module("numba")
    finally:
        for name in absent:
            del sys.modules[name]


_import_numba()
