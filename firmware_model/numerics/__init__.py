"""Compute the same bits on every route, with compiled arithmetic."""

import os
import sys
import warnings
from importlib import import_module
from typing import Any


def _import_numba() -> None:
    """Import numba without packages that it tries and does not need, which take a tenth of each start.

    It looks at `coverage` for a mode of its own that nobody switches on here, and at `yaml` for a file of settings in
    the current folder. Settings name a folder of machine code, so that file would run code: it is never read, neither
    now nor when numba looks for it again. Variables of the environment are.
    """
    hidden = {"yaml": sys.modules.get("yaml")} | ({} if "coverage" in sys.modules else {"coverage": None})
    sys.modules.update(dict.fromkeys(hidden))  # type: ignore[arg-type]  # `None` means that there is no such module
    try:
        with warnings.catch_warnings(action="ignore", category=UserWarning):  # of a file that needs yaml
            import_module("numba")
    finally:
        for name, module in hidden.items():
            del sys.modules[name]
            if module is not None:
                sys.modules[name] = module
    config: Any = import_module("numba.core.config")
    config._config_fname = os.devnull  # no regular file


_import_numba()
