"""Robustness of a law's loop to inertia and actuator lag: proved range of stability and largest sensitivity peak."""

import math
from dataclasses import dataclass

import numpy as np

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.certify.mu.axis_loop import AxisLoop, axis_loop
from gustproof.certify.mu.sweep import Bracket
from gustproof.certify.mu.zero_exclusion import ParameterBox, is_proven
from gustproof.law.form import Law, Matrix
from gustproof.model.uncertainty import Spreads

_LARGEST_DEVIATION = 0.99
"""[-] end of the search: inertia and lag stay positive."""
_SHARES = (0.999, 0.997, 0.99, 0.97, 0.9, 0.8, 0.6, 0.4, 0.2, 0.1)
"""[-] shares of the first instability found that are tried in turn."""
_PEAK_SHARES = (1.001, 1.003, 1.01, 1.03, 1.1, 1.3, 2.0, 4.0)
"""[-] multiples of the largest peak found that are tried in turn."""
_FACTORS, _DIRECTIONS = 64, 65
"""Multiples of the spreads, and points on each edge of the box, in the search for an instability."""


@dataclass(frozen=True, slots=True, kw_only=True)
class UnstableMember:
    """An inertia and a lag with which the axis is unstable, by the Routh test in exact arithmetic."""

    times: float
    """[-] multiple of the spreads that has this member on its edge."""
    inertia: float
    """[-] relative deviation of the inertia."""
    actuator_lag: float
    """[-] relative deviation of the lag."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StabilityRange:
    """Range of constant inertia and lag over which an axis is stable at hover: a proof, and a counterexample beyond."""

    certified: float
    """[-] multiple of the spreads up to which every member is proved stable."""
    unstable: UnstableMember | None
    """Member of the least multiple found that is not all stable; `None` if the search found none."""


def robust_stability(law: Law, vehicle: Vehicle, scenario: Scenario, spreads: Spreads, axis: int) -> StabilityRange:
    """Return how far inertia and lag of an axis may be off together: constant, unknown, as multiples of `spreads`.

    The proof covers the law linear at level attitude and within its limits, on the linear vehicle at hover, sampled and
    delayed, with one lag as one parameter. It holds for all members and at all frequencies, by branch and bound with
    discs in floats (`zero_exclusion`). The unstable member fails the Routh test in exact arithmetic; a smaller one may
    exist where the search did not look.

    Raises
    ------
    ValueError
        If the law couples its axes, uses the accelerometer, commands no torque, has another sample time or more than
        40 states in the axis. Also if the nominal loop is unstable, or both spreads are 0.

    Examples
    --------
    >>> from gustproof import Spreads, load_law, load_scenario, load_vehicle, robust_stability
    >>> law, vehicle, scenario = load_law("pid-fair"), load_vehicle("paper"), load_scenario("paper")
    >>> found = robust_stability(law, vehicle, scenario, Spreads(inertia=0.2, actuator_lag=0.3), axis=0)
    >>> f"stable up to {found.certified:.3f} times the spreads, unstable at {found.unstable.times:.3f}"
    'stable up to 3.059 times the spreads, unstable at 3.062'
    """
    loop = _nominally_stable_loop(law, vehicle, scenario, axis)
    if not max(spreads.inertia, spreads.actuator_lag):
        raise ValueError("both spreads are 0: there is nothing uncertain")
    limit = _LARGEST_DEVIATION / max(spreads.inertia, spreads.actuator_lag)
    unstable = _first_instability(loop, spreads, limit)
    factors = (
        [share * unstable.times for share in _SHARES] if unstable else [limit, *(share * limit for share in _SHARES)]
    )
    certified = next((factor for factor in factors if is_proven(loop, _box(loop, spreads, factor))), 0.0)
    return StabilityRange(certified=certified, unstable=unstable)


def robust_peak(law: Law, vehicle: Vehicle, scenario: Scenario, spreads: Spreads, axis: int) -> Bracket:
    """Return the largest sensitivity peak [-] of an axis at hover with constant inertia and lag within `spreads`.

    The lower bound is attained by the member `delta`; the upper one is proved as in `robust_stability`, infinite if
    nothing is proved.

    Raises
    ------
    ValueError
        Under the conditions of `robust_stability`, but spreads may be 0.

    Examples
    --------
    >>> from gustproof import Spreads, load_law, load_scenario, load_vehicle, robust_peak
    >>> law, vehicle, scenario = load_law("flagship"), load_vehicle("paper"), load_scenario("paper")
    >>> found = robust_peak(law, vehicle, scenario, Spreads(inertia=0.2, actuator_lag=0.3), axis=0)
    >>> f"Ms {found.lower:.2f} at {found.delta}"
    "Ms 2.00 at {'inertia': 1.0, 'actuator_lag': 1.0}"
    """
    loop = _nominally_stable_loop(law, vehicle, scenario, axis)
    peak, omega, direction = _largest_peak(loop, spreads)
    box = _box(loop, spreads, 1.0)
    upper = next((share * peak for share in _PEAK_SHARES if is_proven(loop, box, peak=share * peak)), math.inf)
    delta = {"inertia": float(direction[0]), "actuator_lag": float(direction[1])}
    return Bracket(lower=peak, upper=upper, omega=omega, delta=delta)


def _nominally_stable_loop(law: Law, vehicle: Vehicle, scenario: Scenario, axis: int) -> AxisLoop:
    loop = axis_loop(law, vehicle, scenario, axis)
    if not loop.is_stable_at(loop.inertia, loop.actuator_lag):
        raise ValueError("the nominal loop is unstable")
    return loop


def _box(loop: AxisLoop, spreads: Spreads, factor: float) -> ParameterBox:
    inertia, lag = factor * spreads.inertia, factor * spreads.actuator_lag
    return ParameterBox(
        inertia=((1.0 - inertia) * loop.inertia, (1.0 + inertia) * loop.inertia),
        lag=((1.0 - lag) * loop.actuator_lag, (1.0 + lag) * loop.actuator_lag),
    )


def _members(loop: AxisLoop, spreads: Spreads, deltas: Matrix) -> tuple[Matrix, Matrix]:
    """Return inertia [kg*m^2] and lag [s], (...), at multiples (..., 2) of the spreads."""
    return (
        (1.0 + spreads.inertia * deltas[..., 0]) * loop.inertia,
        (1.0 + spreads.actuator_lag * deltas[..., 1]) * loop.actuator_lag,
    )


def _first_instability(loop: AxisLoop, spreads: Spreads, limit: float) -> UnstableMember | None:
    """Return the unstable member of the least multiple of the spreads found, by grids on the edge and bisection."""
    edge = np.linspace(-1.0, 1.0, _DIRECTIONS)
    directions = np.concatenate([[(x, end), (end, x)] for x in edge for end in (-1.0, 1.0)])
    step = limit / _FACTORS
    factor, found = step, None
    while factor <= limit:
        radii = loop.spectral_radius(*_members(loop, spreads, factor * directions))
        direction = directions[int(np.argmax(radii))]
        if np.max(radii) >= 1.0 and not _is_stable(loop, spreads, factor * direction):
            times = _bisect(loop, spreads, direction, max(factor - step, 0.0), factor)
            inertia, lag = times * direction * (spreads.inertia, spreads.actuator_lag)
            found = UnstableMember(times=times, inertia=float(inertia), actuator_lag=float(lag))
            factor = 0.9999 * times  # another direction may be unstable a little before
        elif found:
            break
        else:
            factor += step
    return found


def _bisect(loop: AxisLoop, spreads: Spreads, direction: Matrix, inside: float, outside: float) -> float:
    """Return a multiple of the spreads along `direction` (2,) that is unstable, just beyond the last stable one."""
    while outside > (1.0 + 1e-5) * inside:
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if _is_stable(loop, spreads, middle * direction) else (inside, middle)
    return outside


def _is_stable(loop: AxisLoop, spreads: Spreads, delta: Matrix) -> bool:
    inertia, lag = _members(loop, spreads, delta)
    return loop.is_stable_at(float(inertia), float(lag))


def _largest_peak(loop: AxisLoop, spreads: Spreads) -> tuple[float, float, Matrix]:
    """Return the largest sensitivity found [-], its frequency [rad/s] and the member's deltas (2,), by finer grids."""
    half_width, centre, omega = 1.0, np.zeros(2), np.geomspace(1e-2, 0.999 * math.pi / loop.dt, 400)
    best, at = 0.0, 0.0
    for _ in range(4):
        axes = [np.clip(np.linspace(x - half_width, x + half_width, 9), -1.0, 1.0) for x in centre]
        deltas = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        S = np.abs(loop.sensitivity(omega, *_members(loop, spreads, deltas)))
        k, i = np.unravel_index(int(np.argmax(S)), S.shape)
        if S[k, i] > best:
            best, at, centre = float(S[k, i]), float(omega[i]), deltas[k]
        ratio = omega[1] / omega[0]
        omega = np.minimum(np.geomspace(at / ratio**2, at * ratio**2, 100), math.pi / loop.dt)
        half_width *= 0.25
    return best, at, centre
