"""Design, prove and fly multirotor attitude control in gusts, over real MAVLink.

Examples
--------
Fly a gust with two laws, look at the flights, and ask what is expected of many:

>>> from gustproof import fly_controller, load_law, load_scenario, load_vehicle, predict
>>> gusts, vehicle = load_scenario("gust-roll"), load_vehicle("paper")
>>> ours = fly_controller(gusts, load_law("flagship"), vehicle=vehicle)
>>> theirs = fly_controller(gusts, load_law("pid-fair"), vehicle=vehicle)
>>> ours.metrics.peak_deg < theirs.metrics.peak_deg
True
>>> picture = ours.plot(theirs)
>>> table = ours.to_arrow()
>>> expected = predict(load_law("flagship"), vehicle, load_scenario("paper-turbulence"))

Notes
-----
A result shows itself when it is printed, and in a notebook. Each name in `__all__` has an example in its docstring.

Names are loaded when they are first used. They and their modules stand in `__init__.pyi`, which type checkers read too
(Scientific Python, SPEC 1).
"""

import sys

from gustproof.version import __version__ as __version__

_stubs: dict[str, dict[str, tuple[str, str]]] = {}


def stub_names(package: str) -> dict[str, tuple[str, str]]:
    """Return each name that the stub of a package imports, with its module and its name there."""
    if package not in _stubs:
        _stubs[package] = _read_stub(package)
    return _stubs[package]


def _read_stub(package: str) -> dict[str, tuple[str, str]]:
    import ast
    from importlib import import_module
    from pathlib import Path

    stub = ast.parse(Path(str(import_module(package).__file__)).with_suffix(".pyi").read_text(encoding="utf-8"))
    found: dict[str, tuple[str, str]] = {}
    for node in stub.body:
        if isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                names = {alias.asname or alias.name: (node.module, alias.name)}
                found |= stub_names(node.module) if alias.name == "*" else names
    return found


def load_name(package: str, name: str) -> object:
    """Return a public name of a package, or `__all__`; its module is imported when it is first used (PEP 562)."""
    sources = stub_names(package)
    if name == "__all__":
        return sorted(sources)
    if name not in sources:
        raise AttributeError(f"module '{package}' has no attribute '{name}'")
    from importlib import import_module

    module, attribute = sources[name]
    value: object = getattr(import_module(module), attribute)
    if "ipykernel" in sys.modules:  # a notebook, where a long silence looks like a fault
        value = import_module("gustproof.show.notebook_progress").with_bar(value)
    return value


def __getattr__(name: str) -> object:
    """Import a public name when it is first used."""
    return load_name(__name__, name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(stub_names(__name__))
