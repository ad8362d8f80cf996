"""Blocks of Delta, the unknowns of an uncertain model, normalised: 0 is nominal and 1 the edge of the range."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import Matrix, as_lti

_BEYOND = 1e-9
"""[-] excess of a value over its range, next to the range, that counts as rounding."""

Delta = Mapping[str, ArrayLike]
"""A value for each named block: a number in [-1, 1] for a real parameter, a matrix of norm <= 1 for a full block.
Omitted names are 0, nominal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RealBlock:
    """A real parameter repeated `repeats` times on the diagonal of Delta (MATLAB: `ureal`).

    Its normalised value is delta in [-1, 1] with `value = nominal + b delta / (1 + c delta)`. This gives low at -1,
    nominal at 0 and high at 1, and is linear when nominal is the middle. The form is rational: no further repetition.

    Raises
    ------
    ValueError
        If not `low < nominal < high`, all finite, or `repeats` is below 1.
    """

    name: str
    """Name, unique in the model: blocks of one name are one parameter."""
    low: float
    """[as the parameter] least value."""
    high: float
    """[as the parameter] largest value."""
    nominal: float
    """[as the parameter] value at delta = 0."""
    repeats: int = 1
    """Number of occurrences on the diagonal."""

    def __post_init__(self) -> None:
        """Check the name and the range."""
        _require_name(self.name)
        if not (np.isfinite(self.low) and np.isfinite(self.high) and self.low < self.nominal < self.high):
            given = f"{self.low}, {self.nominal}, {self.high}"
            raise ValueError(f"parameter '{self.name}': needs finite low < nominal < high, got {given}")
        if self.repeats < 1:
            raise ValueError(f"parameter '{self.name}' is repeated {self.repeats} times, must be at least once")

    @property
    def shape(self) -> tuple[int, int]:
        """Outputs and inputs of the block."""
        return (self.repeats, self.repeats)

    @property
    def n_outputs(self) -> int:
        """Outputs of one occurrence."""
        return 1

    @property
    def n_inputs(self) -> int:
        """Inputs of one occurrence."""
        return 1

    @property
    def coefficients(self) -> tuple[float, float]:
        """`b` and `c` of the normalisation, as of `firmware_model.config.spreads.Spread`."""
        up, down = self.high - self.nominal, self.nominal - self.low
        return 2.0 * up * down / (up + down), (down - up) / (up + down)

    def value(self, delta: ArrayLike) -> Matrix:
        """Return the parameter at the normalised `delta`, (...)."""
        b, c = self.coefficients
        factor = np.asarray(delta, dtype=np.float64)
        with np.errstate(divide="ignore"):  # far beyond a range on one side the value passes infinity
            return np.asarray(self.nominal + b * factor / (1.0 + c * factor))

    def delta(self, value: ArrayLike) -> Matrix:
        """Return the normalised value of the parameter's `value`, (...)."""
        b, c = self.coefficients
        off = np.asarray(value, dtype=np.float64) - self.nominal
        return np.asarray(off / (b - c * off))

    def interval(self, radius: float) -> tuple[float, float]:
        """Return the values at normalised ones in [-radius, radius]; without end where the rational form has a pole."""
        if math.isinf(radius):
            return -math.inf, math.inf
        _, c = self.coefficients
        low = -math.inf if c * radius >= 1.0 else float(self.value(-radius))
        return low, math.inf if -c * radius >= 1.0 else float(self.value(radius))

    def normalise(self, value: ArrayLike) -> float:
        """Return the normalised value of a number in the range; refuse any other."""
        number = np.asarray(value)
        edge = _BEYOND * (self.high - self.low)
        is_real = np.issubdtype(number.dtype, np.number) and np.isrealobj(number)
        inside = number.size == 1 and is_real and self.low - edge <= number.item() <= self.high + edge
        if not inside:
            raise ValueError(f"parameter '{self.name}' is {value!r}, must be in [{self.low:g}, {self.high:g}]")
        return float(np.clip(self.delta(number.item()), -1.0, 1.0))

    def describe(self) -> str:
        """Return what it is in one line."""
        return f"{self.name}: real, {self.nominal:g} in [{self.low:g}, {self.high:g}], {_count(self.repeats)}"


@dataclass(frozen=True, slots=True, kw_only=True)
class FullBlock:
    """A complex full block of norm <= 1: unmodelled dynamics (MATLAB: `ultidyn`, `ucomplex`) or performance channel.

    Raises
    ------
    ValueError
        If the block has no inputs or no outputs, or one that is not 1 x 1 is repeated.
    """

    name: str
    """Name, unique in the model."""
    n_outputs: int = 1
    """Number of rows."""
    n_inputs: int = 1
    """Number of columns."""
    repeats: int = 1
    """Number of occurrences on the diagonal."""
    nominal: float = 0.0
    """[as the block] value at delta = 0."""
    bound: float = 1.0
    """[as the block] distance from `nominal` at norm 1."""
    is_dynamic: bool = True
    """False for a complex number, the same at all frequencies."""

    def __post_init__(self) -> None:
        """Check the name and the size."""
        _require_name(self.name)
        if min(self.n_outputs, self.n_inputs, self.repeats) < 1:
            raise ValueError(f"block '{self.name}' is {self.n_outputs} x {self.n_inputs}, must be at least 1 x 1")
        if self.repeats > 1 and (self.n_outputs, self.n_inputs) != (1, 1):
            raise ValueError(f"block '{self.name}' occurs twice; only one of 1 x 1 may")
        if not (np.isfinite([self.nominal, self.bound]).all() and self.bound > 0.0):
            raise ValueError(f"block '{self.name}': needs a finite nominal value and a positive bound")

    @property
    def shape(self) -> tuple[int, int]:
        """Outputs and inputs of the block, repetitions counted."""
        return (self.repeats * self.n_outputs, self.repeats * self.n_inputs)

    def normalise(self, value: Any) -> Any:
        """Return the normalised value of a matrix or stable system within the bound; refuse any other."""
        if hasattr(value, "A") or hasattr(value, "num"):
            system = as_lti(value)
            size = hinf_norm(system).gain if self.is_dynamic else np.inf
            normed: Any = replace(system, C=system.C / self.bound, D=system.D / self.bound)
        else:
            if not np.issubdtype(np.asarray(value).dtype, np.number):
                raise ValueError(f"block '{self.name}' is {value!r}, must be a number, a matrix or a system")
            normed = (np.atleast_2d(value) - self.nominal) / self.bound
            size = self.bound * float(np.linalg.norm(normed, 2)) if np.isfinite(normed).all() else np.inf
        if not size <= (1.0 + _BEYOND) * self.bound:
            raise ValueError(f"block '{self.name}' has the size {size:.6g}, must be at most {self.bound:g}")
        return normed

    def describe(self) -> str:
        """Return what it is in one line."""
        if not self.is_dynamic:
            return f"{self.name}: complex, within {self.bound:g} of {self.nominal:g}, {_count(self.repeats)}"
        size = f"{self.n_outputs} x {self.n_inputs}"
        return f"{self.name}: unknown dynamics, {size}, gain at most {self.bound:g}, {_count(self.repeats)}"


def _count(repeats: int) -> str:
    return "occurs once" if repeats == 1 else f"occurs {repeats} times"


def _require_name(name: str) -> None:
    if not isinstance(name, str) or not name.strip():
        raise ValueError(f"the name of a block is {name!r}, must be a text that is not empty")


DeltaBlock = RealBlock | FullBlock
"""One block of Delta."""


def rows(blocks: tuple[DeltaBlock, ...]) -> tuple[slice, ...]:
    """Return the rows of each block in Delta, which are inputs of M."""
    return _slices([block.shape[0] for block in blocks])


def columns(blocks: tuple[DeltaBlock, ...]) -> tuple[slice, ...]:
    """Return the columns of each block in Delta, which are outputs of M."""
    return _slices([block.shape[1] for block in blocks])


def delta_matrix(blocks: tuple[DeltaBlock, ...], delta: Delta) -> Matrix:
    """Return the real block-diagonal matrix Delta at `delta`.

    Values outside the unit ball are allowed: the model does not claim to cover them, but its arithmetic holds.

    Raises
    ------
    ValueError
        If a name is unknown, or the shape of a value does not fit its block.
    """
    if unknown := sorted(set(delta) - {block.name for block in blocks}):
        raise ValueError(f"unknown parameter '{unknown[0]}', there are {', '.join(block.name for block in blocks)}")
    parts = [
        _fill(block, np.asarray(delta.get(block.name, np.zeros(block.shape)), dtype=np.float64)) for block in blocks
    ]
    return np.asarray(scipy.linalg.block_diag(*parts) if parts else np.zeros((0, 0)), dtype=np.float64)


def _fill(block: DeltaBlock, value: Matrix) -> Matrix:
    """Return the part of Delta that a value makes: a number is repeated."""
    if value.size == 1 and (isinstance(block, RealBlock) or block.shape == (block.repeats, block.repeats)):
        value = value.item() * np.eye(block.repeats)
    if value.shape != block.shape:
        raise ValueError(f"block '{block.name}' has the shape {block.shape}, its value {value.shape}")
    return value


def _slices(sizes: list[int]) -> tuple[slice, ...]:
    ends = np.cumsum([0, *sizes]).tolist()
    return tuple(slice(start, end) for start, end in pairwise(ends))


@dataclass(frozen=True, slots=True, kw_only=True)
class Spreads:
    """Relative deviations of the vehicle from its file; 0 is the nominal vehicle.

    Raises
    ------
    ValueError
        If a spread is not in [0, 1).

    Examples
    --------
    >>> from gustproof import Spreads
    >>> Spreads(inertia=0.2, actuator_lag=0.3).inertia
    0.2
    """

    inertia: float = 0.0
    """[-] each moment of inertia is between 1 - spread and 1 + spread times the file's."""
    actuator_lag: float = 0.0
    """[-] likewise for the actuator lag."""

    def __post_init__(self) -> None:
        """Check the values."""
        for name, value in (("inertia", self.inertia), ("actuator_lag", self.actuator_lag)):
            if not 0.0 <= value < 1.0:
                raise ValueError(f"{name} spread is {value!r}, must be in [0, 1)")
