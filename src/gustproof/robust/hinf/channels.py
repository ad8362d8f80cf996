"""Units in which a generalised plant is well scaled: its states, controls and measurements.

Those of w and z are part of the problem: other ones would change the norm, a common factor only the level.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from gustproof.errors import DesignError
from gustproof.robust.hinf.checked_controller import ROUNDING_ERRORS
from gustproof.robust.lti.balancing import state_units
from gustproof.robust.lti.state_space import Lti, Matrix

_SWEEPS = 30
"""Number of rounds of the search for units; it stops when none changes."""

_BADLY_SCALED = 1e4
"""[-] spread of the states' units from which a plant is solved in better ones; below it, only if its own fail."""
_ALIKE = 1e6
"""[-] largest ratio of two rows or columns of the states for which no better units are sought first."""

Found = TypeVar("Found")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlantUnits:
    """Powers of two that bring a plant into other units; they round nothing."""

    x: Matrix
    """(n,) a state is so many new units."""
    u: Matrix
    """(m2,) a control is so many new units."""
    y: Matrix
    """(p2,) a new measurement is so many old units."""

    @property
    def spread(self) -> float:
        """Measure of bad scaling [-]: largest ratio of two units of the states."""
        return float(np.max(self.x) / np.min(self.x))

    @property
    def is_identity(self) -> bool:
        """True if no unit differs from the plant's."""
        return all(each.tolist().count(1.0) == each.size for each in (self.x, self.u, self.y))

    def __mul__(self, other: "PlantUnits") -> "PlantUnits":
        return PlantUnits(x=self.x * other.x, u=self.u * other.u, y=self.y * other.y)

    def apply(self, P: Lti, n_meas: int, n_con: int) -> Lti:
        """Return the plant in the new units; raise `OverflowError` if no float holds it."""
        if self.is_identity:
            return P
        p1, m1 = P.n_outputs - n_meas, P.n_inputs - n_con
        rows, columns = np.concatenate([np.ones(p1), self.y]), np.concatenate([np.ones(m1), self.u])
        A, B = P.A * self.x / self.x[:, None], P.B * columns / self.x[:, None]
        C, D = rows[:, None] * P.C * self.x, rows[:, None] * P.D * columns
        if not all(np.isfinite(matrix).all() for matrix in (A, B, C, D)):
            raise OverflowError("its units differ by more than a float holds")
        return Lti(A=A, B=B, C=C, D=D, dt=P.dt)

    def restore(self, K: Lti) -> Lti:
        """Return a controller in the old units; its states are in the units of the plant's."""
        if self.is_identity:
            return K
        x, u = self.x[:, None], self.u[:, None]
        return Lti(A=x * K.A / self.x, B=x * K.B * self.y, C=u * K.C / self.x, D=u * K.D * self.y, dt=K.dt)


def solve_in_best_units(P: Lti, n_meas: int, n_con: int, solve: Callable[[Lti, PlantUnits], Found]) -> Found:
    """Return `solve` of a plant in its own units and these, or in better ones if its own are bad or fail.

    The first error counts if both fail.
    """
    own = own_units(P, n_meas, n_con)
    if not _looks_well_scaled(P, n_meas, n_con):
        better = find_units(P, n_meas, n_con)
        if better.spread > _BADLY_SCALED:
            return solve(better.apply(P, n_meas, n_con), better)
    try:
        return solve(P, own)
    except (DesignError, *ROUNDING_ERRORS) as failure:
        refusal = failure
    better = find_units(P, n_meas, n_con)
    if better.is_identity:
        raise refusal
    try:
        return solve(better.apply(P, n_meas, n_con), better)
    except (DesignError, *ROUNDING_ERRORS):
        raise refusal from None


def _looks_well_scaled(P: Lti, n_meas: int, n_con: int) -> bool:
    """Return True if rows and columns of the states are of like size, so that no search for units is worth its time."""
    into = np.linalg.norm(np.hstack([P.A, P.B[:, :-n_con]]), axis=1)
    out = np.linalg.norm(np.vstack([P.A, P.C[:-n_meas]]), axis=0)
    sizes = np.concatenate([into, out])
    return bool(sizes.max() <= _ALIKE * sizes.min(where=sizes > 0.0, initial=np.inf))


def own_units(P: Lti, n_meas: int, n_con: int) -> PlantUnits:
    """Return the units that a plant has."""
    return PlantUnits(x=np.ones(P.order), u=np.ones(n_con), y=np.ones(n_meas))


def find_units(P: Lti, n_meas: int, n_con: int) -> PlantUnits:
    """Return units in which rows and columns of the states are of one size, and each control and measurement near 1.

    Both are found by turns until nothing changes. A control is measured by its column of (B2, D12), or of D12 alone
    where that is not 0; a measurement by its row of (C2, D21).
    """
    p1, m1 = P.n_outputs - n_meas, P.n_inputs - n_con
    units = own_units(P, n_meas, n_con)
    for _ in range(_SWEEPS):
        u = 1.0 / _sizes(np.abs(P.D[:p1, m1:]), np.abs(P.B[:, m1:]) / units.x[:, None])
        y = 1.0 / _sizes(np.abs(P.D[p1:, :m1]).T, (np.abs(P.C[p1:]) * units.x).T)
        columns, rows = np.append(np.ones(m1), u), np.append(np.ones(p1), y)
        x = state_units(Lti(A=P.A, B=P.B * columns, C=rows[:, None] * P.C, D=np.zeros_like(P.D)))
        units, before = PlantUnits(x=x, u=u, y=y), units
        if np.array_equal(units.x, before.x):
            break
    return units


def _sizes(D: Matrix, B: Matrix) -> Matrix:
    """Return powers of two near the size of each column of D, or of B where that of D is 0; 1 if both are."""
    first, second = np.linalg.norm(D, axis=0), np.linalg.norm(B, axis=0)
    sizes = np.where(first > 0.0, first, second)
    return _power_of_two(np.where(sizes > 0.0, sizes, 1.0))


def _power_of_two(value: Matrix) -> Matrix:
    return np.asarray(np.exp2(np.rint(np.log2(value))), dtype=np.float64)
