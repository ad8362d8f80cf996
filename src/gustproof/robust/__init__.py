"""Robust control without flight: linear systems, LFTs, synthesis, structured values, certified gains.

Its public names stand in `__init__.pyi` and are loaded when they are first used. `gustproof` has them too.
"""

import gustproof


def __getattr__(name: str) -> object:
    """Import a public name when it is first used."""
    return gustproof.load_name(__name__, name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(gustproof.stub_names(__name__))
