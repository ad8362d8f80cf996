"""The unknowns that uncertain systems are written with: real and complex numbers, and dynamics of bounded gain."""

from typing import Any

import numpy as np

from gustproof.robust.lti.state_space import gain
from gustproof.robust.uncertain.uncertain_system import Uncertain
from gustproof.robust.uncertain.uncertainty import FullBlock, RealBlock

Spread = float | tuple[float, float]
"""A deviation both ways, or the lower, negative, and the upper one."""


def ureal(
    name: str,
    nominal: float | None = None,
    *,
    range: tuple[float, float] | None = None,
    percent: Spread | None = None,
    plus_minus: Spread | None = None,
) -> Uncertain:
    """Return an uncertain real number as a system of one channel (MATLAB: `ureal`).

    Its interval is a `range`, or `nominal` with a deviation in `percent` of it or `plus_minus` in its own unit. Exactly
    one of them is given. The nominal value of a range is its middle unless given.

    Raises
    ------
    ValueError
        If none or several are given, or not `low < nominal < high`.

    Examples
    --------
    >>> from gustproof.robust import ureal
    >>> mass = ureal("mass", 2.0, percent=(-10, 20))
    >>> mass + mass**2
    Uncertain: 1 output, 1 input, 0 states, continuous
    mass: real, 2 in [1.8, 2.4], occurs 2 times
    """
    given = {"range": range, "percent": percent, "plus_minus": plus_minus}
    if sum(each is not None for each in given.values()) != 1:
        raise ValueError(f"parameter '{name}': give one of {', '.join(given)}")
    if range is not None:
        low, high = _pair(name, range)
        nominal = 0.5 * (low + high) if nominal is None else nominal
    elif nominal is None:
        raise ValueError(f"parameter '{name}': a deviation needs the nominal value")
    else:
        spread: Any = plus_minus if percent is None else percent
        unit = 1.0 if percent is None else 0.01 * abs(nominal)
        down, up = _pair(name, spread if np.ndim(spread) else (-spread, spread))
        low, high = nominal + unit * down, nominal + unit * up
    block = RealBlock(name=name, low=float(low), high=float(high), nominal=float(nominal))
    b, c = block.coefficients
    return Uncertain(M=gain([[-c, 1.0], [b, block.nominal]]), blocks=(block,))


def _pair(name: str, ends: Any) -> tuple[float, float]:
    """Return the ends of a range or deviation."""
    if np.shape(ends) != (2,):
        raise ValueError(f"parameter '{name}': {ends!r} must be two numbers, the lower one first")
    low, high = ends
    return float(low), float(high)


def ucomplex(name: str, nominal: float, radius: float) -> Uncertain:
    """Return an uncertain complex number within `radius` of a real `nominal` (MATLAB: `ucomplex`).

    Examples
    --------
    >>> from gustproof.robust import ucomplex
    >>> 2.0 * ucomplex("c", 1.0, 0.3)
    Uncertain: 1 output, 1 input, 0 states, continuous
    c: complex, within 0.3 of 1, occurs once
    """
    if np.iscomplexobj(nominal):
        raise ValueError(f"block '{name}' has the nominal value {nominal}, must be real")
    block = FullBlock(name=name, nominal=float(nominal), bound=float(radius), is_dynamic=False)
    return Uncertain(M=gain([[0.0, 1.0], [radius, nominal]]), blocks=(block,))


def ultidyn(name: str, n_outputs: int = 1, n_inputs: int = 1, *, bound: float = 1.0) -> Uncertain:
    """Return a stable unknown system with an H-infinity norm of at most `bound` (MATLAB: `ultidyn`).

    Examples
    --------
    >>> from control import tf
    >>> from gustproof.robust import ultidyn
    >>> 1 + tf([1, 0], [1, 10]) * ultidyn("unmodelled", bound=0.4)
    Uncertain: 1 output, 1 input, 1 state, continuous
    unmodelled: unknown dynamics, 1 x 1, gain at most 0.4, occurs once
    """
    if not (isinstance(n_outputs, (int, np.integer)) and isinstance(n_inputs, (int, np.integer))):
        raise ValueError(f"block '{name}': give two whole numbers, of outputs and inputs: ultidyn('{name}', 2, 3)")
    block = FullBlock(name=name, n_outputs=n_outputs, n_inputs=n_inputs, bound=float(bound))
    passed = np.block(
        [[np.zeros((n_inputs, n_outputs)), np.eye(n_inputs)], [bound * np.eye(n_outputs), np.zeros(block.shape)]]
    )
    return Uncertain(M=gain(passed), blocks=(block,))
