"""Parts of a loop that are no real parameters: delays, sectors, and functions with slopes in [0, 1]."""

import math
from dataclasses import dataclass

import numpy as np

from gustproof.checker.evidence_types import PartTable
from gustproof.robust.lti.state_space import ComplexMatrix, Matrix


@dataclass(frozen=True, slots=True, kw_only=True)
class Delay:
    """A delay of all channels of a block: it adds `p(t) = q(t - theta) - q(t)`.

    Raises
    ------
    ValueError
        If the largest delay or a pole is not positive, or a varying delay has poles.

    Examples
    --------
    >>> from gustproof import Delay
    >>> Delay(largest=0.008).varying
    False
    """

    largest: float
    """[s] theta is in [0, largest]."""
    varying: bool = False
    """True if theta varies at will, as of a command that is held between samples; False if it is constant."""
    poles: tuple[float, ...] = ()
    """[rad/s] poles of the multipliers; more of them prove more and take longer."""

    def __post_init__(self) -> None:
        """Check the values."""
        if not 0.0 < self.largest < math.inf:
            raise ValueError(f"the largest delay is {self.largest} s, must be positive")
        _check_poles(self.poles)
        if self.varying and self.poles:
            raise ValueError("the multiplier of a varying delay is constant: it has no poles")

    def entries(self) -> PartTable:
        """Return the entries of the block that name the part."""
        return {"kind": "varying delay" if self.varying else "delay", "largest": self.largest}

    def members(self, omega: Matrix) -> ComplexMatrix:
        """Return p / q (m, k) of some constant delays at the frequencies `omega` (k,) [rad/s]."""
        times = np.linspace(0.0, self.largest, 9)
        return np.asarray(np.expm1(-1j * np.outer(times, omega)), dtype=np.complex128)


@dataclass(frozen=True, slots=True, kw_only=True)
class Slope:
    """Functions p = phi(q) of each channel, phi(0) = 0, with slopes in [0, 1]: saturation, dead zone.

    Raises
    ------
    ValueError
        If a pole is not positive.

    Examples
    --------
    >>> from gustproof import Slope
    >>> Slope(poles=(3.0,)).odd
    True
    """

    odd: bool = True
    """True if phi(-q) = -phi(q)."""
    poles: tuple[float, ...] = ()
    """[rad/s] poles of the multipliers of Zames and Falb; without any, only the sector is used."""

    def __post_init__(self) -> None:
        """Check the values."""
        _check_poles(self.poles)

    def entries(self) -> PartTable:
        """Return the entries of the block that name the part."""
        return {"kind": "slope", "odd": self.odd}

    def members(self, omega: Matrix) -> ComplexMatrix:
        """Return p / q (m, k) of some linear functions at the frequencies `omega` (k,) [rad/s]."""
        return _linear_members(omega)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sector:
    """Functions p = phi(q, t) of each channel, each between 0 and q.

    Examples
    --------
    >>> from gustproof import Sector
    >>> Sector().entries()
    {'kind': 'sector'}
    """

    def entries(self) -> PartTable:
        """Return the entries of the block that name the part."""
        return {"kind": "sector"}

    def members(self, omega: Matrix) -> ComplexMatrix:
        """Return p / q (m, k) of some linear functions at the frequencies `omega` (k,) [rad/s]."""
        return _linear_members(omega)


Part = Delay | Slope | Sector
"""A block of a loop that is no real parameter."""


def _linear_members(omega: Matrix) -> ComplexMatrix:
    return np.outer(np.linspace(0.0, 1.0, 6), np.ones_like(omega)).astype(np.complex128)


def _check_poles(poles: tuple[float, ...]) -> None:
    if not all(0.0 < pole < math.inf for pole in poles):
        raise ValueError(f"poles are {poles}, must be positive")
