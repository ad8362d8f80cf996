"""Singular problems, solved with small weights and noise added until the least level falls no more."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from gustproof.errors import DesignError
from gustproof.robust.hinf.channels import PlantUnits, find_units, own_units
from gustproof.robust.hinf.checked_controller import ROUNDING_ERRORS
from gustproof.robust.hinf.conditions import SingularProblemError
from gustproof.robust.lti.state_space import Lti

_WEIGHTS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
"""[-] weights tried, in units in which the plant is of order 1."""
_NEGLIGIBLE = 1e-5
"""[-] part of the level that a smaller regularisation is not tried for."""
_AGREEMENT = 2e-7
"""[-] relative difference of two levels that is within the resolution of their search."""

Found = TypeVar("Found")


def solve_or_regularize(
    plant: Lti,
    sizes: tuple[int, int],
    solve: Callable[[Lti, PlantUnits], Found],
    level_of: Callable[[Found], float],
    *,
    regularize: bool,
) -> tuple[Found, float, float]:
    """Return what `solve` makes of a plant in its own units, or of the least useful regularisation of a singular one.

    The weight and an estimate of what it adds to the level follow; both are 0 for a regular problem. `sizes` are the
    numbers of measurements and controls.
    """
    try:
        return solve(plant, own_units(plant, *sizes)), 0.0, 0.0
    except SingularProblemError as fault:
        if not regularize:
            raise
        refusal = fault
    units = find_units(plant, *sizes)
    scaled = units.apply(plant, *sizes)
    return _regularize(lambda weight: solve(add_small_weights(scaled, *sizes, weight), units), level_of, refusal)


def _regularize(
    attempt: Callable[[float], Found], level_of: Callable[[Found], float], refusal: DesignError
) -> tuple[Found, float, float]:
    """Return what the least useful weight gives, that weight, and an estimate of what it adds to the level.

    The closed loop of the plant is a part of that of the regularised one, so its norm is not larger, whatever the
    controller. A smaller weight has a smaller least level. The levels of a falling sequence tell what is left.
    Without an attempt that succeeds, the last one's `DesignError` is raised, or `refusal`.
    """
    found: list[tuple[Found, float, float]] = []
    levels: list[float] = []
    for weight in _WEIGHTS:
        try:
            result = attempt(weight)
        except (DesignError, *ROUNDING_ERRORS) as failure:
            if found:
                break
            refusal = failure if isinstance(failure, DesignError) else refusal
            continue
        levels.append(level_of(result))
        if not _is_converging(levels):
            break
        found.append((result, weight, _remaining(levels)))
        if found[-1][2] <= _NEGLIGIBLE * levels[-1]:
            break
    if not found:
        raise refusal
    return found[-1]


def _is_converging(levels: list[float]) -> bool:
    """Return False if the last of a falling sequence shows that rounding has taken over."""
    steps = -np.diff(levels[-3:])
    return not np.any(steps < -_AGREEMENT * levels[-1]) and (len(steps) < 2 or steps[1] <= steps[0])


def _remaining(levels: list[float]) -> float:
    """Return how far a falling sequence is from its limit, by its last three members as a geometric one."""
    if len(levels) < 2:
        return np.inf
    rounding = _AGREEMENT * levels[-1]
    last = max(levels[-2] - levels[-1], rounding)
    if len(levels) == 2 or last == rounding:
        return last
    first = levels[-3] - levels[-2]
    return max(last * last / (first - last), rounding) if first > last else np.inf


def add_small_weights(P: Lti, n_meas: int, n_con: int, weight: float) -> Lti:
    """Return the plant with weighted states and controls added to z, and noise on both states and measurements to w."""
    n, p1, m1 = P.order, P.n_outputs - n_meas, P.n_inputs - n_con
    x, u, y = (weight * np.eye(size) for size in (n, n_con, n_meas))
    B = np.hstack([P.B[:, :m1], x, np.zeros((n, n_meas)), P.B[:, m1:]])
    C = np.vstack([P.C[:p1], x, np.zeros((n_con, n)), P.C[p1:]])
    D = np.zeros((C.shape[0], B.shape[1]))
    D[:p1, :m1], D[:p1, -n_con:] = P.D[:p1, :m1], P.D[:p1, m1:]
    D[-n_meas:, :m1], D[-n_meas:, -n_con:] = P.D[p1:, :m1], P.D[p1:, m1:]
    D[p1 + n : -n_meas, -n_con:], D[-n_meas:, m1 + n : -n_con] = u, y
    return Lti(A=P.A, B=B, C=C, D=D, dt=P.dt)
