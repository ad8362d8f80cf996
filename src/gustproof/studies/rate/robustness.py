"""Robustness of a law's loop to inertia and actuator lag: proved range of stability and largest sensitivity peak."""

import math
from dataclasses import dataclass

import numpy as np

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.law.form import Law, Matrix
from gustproof.robust.mu.sweep import Bracket
from gustproof.robust.uncertain.uncertainty import Spreads
from gustproof.studies.rate.axis_loop import AxisLoop, axis_loop
from gustproof.studies.rate.zero_exclusion import End, ParameterBox, is_proven, proven_bands

_LARGEST_DEVIATION = 0.99
"""[-] end of the search: inertia and lag stay positive."""
_SHARES = (0.999, 0.997, 0.99, 0.97, 0.9, 0.8, 0.6, 0.4, 0.2, 0.1)
"""[-] shares of the first instability found that are tried in turn."""
_PEAK_SHARES = (1.001, 1.003, 1.01, 1.03, 1.1, 1.3, 2.0, 4.0)
"""[-] multiples of the largest peak found that are tried in turn."""
_BANDS, _BAND_POINTS, _BAND_LAGS, _BAND_FACTORS = 48, 8, 401, 120
"""Bands of frequency, points and lags tried on each, and multiples of the spreads tried for a proof."""
_QUICK_SHARES, _QUICK_CELLS = (0.95, 0.8), 20_000
"""[-] shares of the multiple at which a corner is unstable, and cells of a proof, that save the search below it."""
_HOPELESS = 1.02
"""[-] share of a multiple found to have a pole, above which no proof is tried: the lags tried are that far apart."""
_LOWEST_BAND = 0.5
"""[rad/s] begin of the first band."""
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobustnessOverFrequency:
    """Bounds of mu and of the sensitivity of an axis on bands of frequency, for constant inertia and lag.

    Upper bounds are proved at every frequency of their band; lower ones are those of members that were tried.
    """

    omega: Matrix
    """(k + 1,) [rad/s] ends of the bands."""
    mu_proved: Matrix
    """(k,) [-] the family within 1 / mu times the spreads has no pole on the band; infinite if nothing is proved."""
    mu_floor: float
    """[-] 1 over the largest multiple of the spreads that was tried; no proof is below it."""
    mu_found: Matrix
    """(k,) [-] a member of 1 / mu times the spreads has a pole on the band; 0 if none was found."""
    S_proved: Matrix
    """(k,) [-] bound of the sensitivity over the spreads; infinite if nothing is proved."""
    S_found: Matrix
    """(k,) [-] largest sensitivity found within the spreads."""


def robustness_over_frequency(
    law: Law, vehicle: Vehicle, scenario: Scenario, spreads: Spreads, axis: int
) -> RobustnessOverFrequency:
    """Return mu and the largest sensitivity of an axis at hover, band by band (MATLAB: `mussv`, `wcsigma`).

    Raises
    ------
    ValueError
        Under the conditions of `robust_stability`.
    """
    loop = _nominally_stable_loop(law, vehicle, scenario, axis)
    limit = _LARGEST_DEVIATION / max(spreads.inertia, spreads.actuator_lag)
    omega = np.geomspace(_LOWEST_BAND, 0.999 * math.pi / loop.dt, _BANDS + 1)
    mu_found = _mu_on_bands(loop, spreads, omega, limit)
    S_found, S_proved = _peaks_on_bands(loop, spreads, omega), np.full(_BANDS, math.inf)
    box = _box(loop, spreads, np.ones(_BANDS))
    for share in _PEAK_SHARES[3:]:
        proven = proven_bands(loop, box, omega, share * S_found, np.isinf(S_proved))
        S_proved = np.where(proven, share * S_found, S_proved)
    return RobustnessOverFrequency(
        omega=omega,
        mu_proved=_prove_mu(loop, spreads, omega, mu_found, limit),
        mu_floor=1.0 / limit,
        mu_found=mu_found,
        S_proved=S_proved,
        S_found=S_found,
    )


def _prove_mu(loop: AxisLoop, spreads: Spreads, omega: Matrix, mu_found: Matrix, limit: float) -> Matrix:
    """Return 1 over the largest multiple of the spreads proved on each band (k,) [-], by bisection of those tried."""
    factors = np.geomspace(0.05 * limit, limit, _BAND_FACTORS)
    proved, failed = np.full(_BANDS, -1), np.sum(factors[:, None] * mu_found < _HOPELESS, axis=0)
    while np.any(tried := failed - proved > 1):
        middle = (proved + failed) // 2
        box = _box(loop, spreads, factors[middle.clip(0)])
        proven = proven_bands(loop, box, omega, np.full(_BANDS, math.inf), tried)
        proved, failed = np.where(proven, middle, proved), np.where(tried & ~proven, middle, failed)
    return np.where(proved < 0, math.inf, 1.0 / factors[proved])


def _on_bands(omega: Matrix) -> Matrix:
    """Return `_BAND_POINTS` frequencies on each band, (k, points), ends included."""
    return np.geomspace(omega[:-1], omega[1:], _BAND_POINTS, axis=1)


def _peaks_on_bands(loop: AxisLoop, spreads: Spreads, omega: Matrix) -> Matrix:
    """Return the largest sensitivity found on each band (k,) [-]."""
    deltas = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 5)] * 2), axis=-1).reshape(-1, 2)
    S = np.abs(loop.sensitivity(_on_bands(omega).ravel(), *_members(loop, spreads, deltas)))
    return np.asarray(np.max(S, axis=0).reshape(-1, _BAND_POINTS).max(axis=1))


def _mu_on_bands(loop: AxisLoop, spreads: Spreads, omega: Matrix, limit: float) -> Matrix:
    """Return 1 over the least multiple of the spreads, up to `limit`, found to have a pole on each band (k,) [-].

    At a frequency and a lag a pole needs one inertia, `1 - 1/S` times the nominal one: real where its imaginary part
    changes its sign along the lags.
    """
    shares = np.linspace(-limit, limit, _BAND_LAGS) * spreads.actuator_lag
    frequencies, nominal = _on_bands(omega).ravel(), np.full(_BAND_LAGS, loop.inertia)
    needed = 1.0 - 1.0 / loop.sensitivity(frequencies, nominal, (1.0 + shares) * loop.actuator_lag)
    before, after = needed[:-1], needed[1:]
    crosses = before.imag * after.imag <= 0.0
    weight = np.where(crosses, before.imag / np.where(crosses, before.imag - after.imag, 1.0), 0.0)
    inertia = before.real + weight * (after.real - before.real) - 1.0
    lag = shares[:-1, None] + weight * (shares[1:] - shares[:-1])[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):  # a spread of 0 excludes any deviation
        times = np.maximum(np.abs(inertia) / spreads.inertia, np.abs(lag) / spreads.actuator_lag)
    least = np.min(np.where(crosses & (times <= limit), times, math.inf), axis=0)
    return np.asarray(1.0 / least.reshape(-1, _BAND_POINTS).min(axis=1))


def _nominally_stable_loop(law: Law, vehicle: Vehicle, scenario: Scenario, axis: int) -> AxisLoop:
    loop = axis_loop(law, vehicle, scenario, axis)
    if not loop.is_stable_at(loop.inertia, loop.actuator_lag):
        raise ValueError("the nominal loop is unstable")
    return loop


def _box(loop: AxisLoop, spreads: Spreads, factor: End) -> ParameterBox[End]:
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
    """Return the unstable member of the least multiple of the spreads found, by grids on the edge and bisection.

    Multiples proved to have none are left out.
    """
    edge = np.linspace(-1.0, 1.0, _DIRECTIONS)
    directions = np.concatenate([[(x, end), (end, x)] for x in edge for end in (-1.0, 1.0)])
    step = limit / _FACTORS
    factor, found = step, None
    proved = _prove_most(loop, spreads, step)
    while factor <= proved:
        factor += step
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


def _prove_most(loop: AxisLoop, spreads: Spreads, step: float) -> float:
    """Return a multiple of the spreads that is quickly proved stable: a share of the first unstable corner's, or 0."""
    corners = np.array([(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)])
    factors = step * np.arange(1, _FACTORS + 1)
    members = (factors[:, None, None] * corners).reshape(-1, 2)
    radii = loop.spectral_radius(*_members(loop, spreads, members)).reshape(_FACTORS, -1).max(axis=1)
    first = factors[np.argmax(radii >= 1.0)] if np.any(radii >= 1.0) else factors[-1]
    tried = [share * first for share in _QUICK_SHARES]
    return next((each for each in tried if is_proven(loop, _box(loop, spreads, each), most=_QUICK_CELLS)), 0.0)


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
