"""Design, prove and fly multirotor attitude control in gusts, over real MAVLink.

The public API: each name in `__all__` has an example in its docstring, and is loaded when it is first used. Names and
their modules stand in `__init__.pyi`, which type checkers read too (Scientific Python, SPEC 1).
"""

from functools import cache
from importlib import import_module

from gustproof.version import __version__ as __version__


@cache
def _sources() -> dict[str, tuple[str, str]]:
    """Return each public name with its module and its name there."""
    import ast
    from pathlib import Path

    stub = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom) and node.module]
    return {alias.asname or alias.name: (str(node.module), alias.name) for node in imports for alias in node.names}


def __getattr__(name: str) -> object:
    """Import a public name when it is first used (PEP 562)."""
    if name == "__all__":
        return sorted(_sources())
    if name not in _sources():
        raise AttributeError(f"module 'gustproof' has no attribute '{name}'")
    module, attribute = _sources()[name]
    value = globals()[name] = getattr(import_module(module), attribute)
    return value


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(_sources())
