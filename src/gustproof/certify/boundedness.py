"""Certified bounds on the flight of a law: sampled, delayed by a sample, nonlinear, under any moment within a bound.

The horizon limits the certified share of the moment. Without a leak nothing reduces an attitude error again. The bound
of `(T(E) - T(x0)) x1`, rate times attitude error, adds up without its sign. Over a minute the box closes only while
`horizon * rate` is below about 1/2. In flight that product changes sign with the rate, and the error stays far inside.
"""

import math
from fractions import Fraction
from typing import Any

from firmware_model.config.vehicle import Vehicle
from gustproof.certify.certificate import Certificate
from gustproof.certify.check.evidence import COMMAND_SHARE, Refusal, check_box
from gustproof.certify.check.invariant_box import (
    LONGEST,
    SIGNALS,
    AxisNorms,
    Box,
    axis_norms,
    map_box,
    rate_shares,
)
from gustproof.law.form import Law, Output

_ROUNDS = 400
"""Most rounds of growth; a box that has not settled by then counts as open."""
_MIN_ROUNDS = 12
"""Rounds after which the steps of a box that settles become shorter: a change has passed through all signals."""
_GROWTH = Fraction(1, 10**6)
"""[-] relative widening of a box in each round, so that it closes with slack."""
_TOLERANCE = Fraction(1, 1000)
"""[-] relative tolerance of the bisection for the largest share of the moment."""
_MIN_LEVEL = Fraction(1, 1 << 14)
"""[-] share of the moment below which the search gives up."""
_RAREST = 1e-100
"""[-] least probability of noise beyond its bounds that floating point can handle."""


def certify_boundedness(
    law: Law,
    vehicle: Vehicle,
    *,
    moment: tuple[float, float, float],
    horizon: float,
    leak: float = 0.0,
    noise: float = 0.0,
    risk: float = 1e-3,
) -> Certificate:
    """Return a certificate of the largest share of `moment` under which the flight provably stays in a box.

    The proof assumes nothing of rho: attitude, rates and estimates are bounded from the moment. The certificate's
    `gain` is the share, at most 1; its evidence holds the box. Its `lower_bound` is 0, as no flight is simulated;
    `gustproof.falsify.worst_case.reached_share` measures how tight the box is.

    Parameters
    ----------
    law
        Torque law with three states an axis, ordered roll, pitch, yaw (a central controller), scheduled or not.
    vehicle
        Airframe; its gyro noise is ignored, see `noise`.
    moment
        (3,) [N*m] B, bound of the disturbance moment about each axis. The moment is any function of time, even one
        that oscillates between the gyro's samples.
    horizon
        [s] from rest and level attitude, at most `LONGEST` samples.
    leak
        [1/s] of the Euler kinematics; 0 is the true vehicle.
    noise
        [rad/s] rms of the white Gaussian noise of a gyro sample.
    risk
        [-] probability that the noise leaves its bounds; unused without noise.

    Raises
    ------
    ValueError
        If the law has another form, or a number is out of range.

    Examples
    --------
    >>> from gustproof import certify_boundedness, load_law, load_vehicle
    >>> law, vehicle = load_law("hinf-scheduled"), load_vehicle("paper")
    >>> certificate = certify_boundedness(law, vehicle, moment=(0.65, 0.65, 0.3), horizon=0.2)
    >>> (certificate.proven, certificate.gain)
    (True, 1.0)
    """
    _check_law(law)
    _check_numbers(law.dt, moment, horizon, leak, noise, risk)
    evidence = _evidence(law, vehicle, moment, horizon, leak, noise, risk)
    norms = [axis_norms(evidence, axis) for axis in range(3)]
    level, box = _largest_level(evidence, norms)
    evidence["box"] = [[float(value) for value in row] for row in box]
    proven = bool(box) and _is_invariant(level, evidence, norms)
    return Certificate(
        statement=_statement(law, level, moment, horizon, box) if proven else "no share of the moment is covered",
        gain=float(level) if proven else None,
        lower_bound=0.0,
        proven=proven,
        assumes=_assumptions(law, moment, horizon, leak, noise, risk),
        evidence=evidence,
        residual=_slack(evidence, norms, level, box) if proven else None,
    )


def _check_law(law: Law) -> None:
    if law.order != 9 or law.output is not Output.TORQUE:
        raise ValueError(
            "a closure supports H-infinity torque laws with 9 states (hinf-d1, hinf-d2, hinf-scheduled); "
            f"law '{law.name}' has {law.order} and commands {law.output.value}"
        )
    if law.uses_accelerometer:
        raise ValueError(f"law '{law.name}' uses the accelerometer, must measure rates alone")


def _check_numbers(
    dt: float, moment: tuple[float, float, float], horizon: float, leak: float, noise: float, risk: float
) -> None:
    if not (all(0.0 <= limit < math.inf for limit in moment) and max(moment) > 0.0):
        raise ValueError(f"moment is {moment}, must be positive")
    if not _RAREST <= risk < 1.0:
        raise ValueError(f"risk is {risk}, must be a probability, {_RAREST} or more")
    if not (0.0 <= leak < math.inf and 0.0 <= noise < math.inf):
        raise ValueError(f"leak is {leak} and noise {noise}, must not be negative")
    if not dt <= horizon <= LONGEST * dt:
        raise ValueError(
            f"horizon is {horizon:g} s, must be positive, from {dt:g} to {LONGEST * dt:g} s: every sample is simulated"
        )


def _evidence(
    law: Law,
    vehicle: Vehicle,
    moment: tuple[float, float, float],
    horizon: float,
    leak: float,
    noise: float,
    risk: float,
) -> dict[str, Any]:
    """Return the evidence, with an empty box."""
    samples = math.ceil(horizon / law.dt)
    count = 3 * (len(SIGNALS) + 3) * (samples + 1)
    return {
        "kind": "closure",
        "vehicle": {
            "inertia_B": list(vehicle.inertia_B),
            "rate_damping": vehicle.rate_damping,
            "actuator_lag": vehicle.actuator_lag,
        },
        "leak": leak,
        "law": {
            **{name: getattr(law, name).tolist() for name in "ACG"},
            **{name: getattr(law, name)[:, :3].tolist() for name in "BD"},
            "dt": law.dt,
            "limits": law.limits.tolist(),
            **_rate_limit(law),
        },
        "samples": samples,
        "moment": list(moment),
        "noise": noise,
        "risk": risk,
        "deviations": math.sqrt(2.0 * math.log(count / risk)) + 1e-6,
        "box": [],
    }


def _rate_limit(law: Law) -> dict[str, Any]:
    """Return the limit of the rate commanded from attitude, which the proof shows to be inactive."""
    if law.rate_limit is None:
        return {}
    S, T, limits = law.rate_limit.S, law.rate_limit.T[:, :3], law.rate_limit.limits
    return {"rate_limit": {"S": S.tolist(), "T": T.tolist(), "limits": limits.tolist()}}


def _assumptions(
    law: Law, moment: tuple[float, float, float], horizon: float, leak: float, noise: float, risk: float
) -> dict[str, Any]:
    return {
        "plant": "nonlinear rigid body, first-order actuators; the law in exact arithmetic, float32 on the wire",
        "law": law.name,
        "leak_per_s": leak,
        "sample_time_s": law.dt,
        "delay_samples": 1,
        "moment_N_m": list(moment),
        "rho": "nothing",
        "horizon_s": horizon,
        "start": "at rest, level, estimates 0",
        "noise_rad_s": noise,
        "noise_probability": risk if noise else 0.0,
    }


def _statement(law: Law, level: Fraction, moment: tuple[float, float, float], horizon: float, box: Box) -> str:
    angles = ", ".join(f"{math.degrees(row[0]):.3g}" for row in box)
    torques = ", ".join(f"{float(row[SIGNALS.index('command')]):.3g}" for row in box)
    return (
        f"for {horizon:g} s law '{law.name}' keeps |phi|, |theta|, |psi| below {angles} deg and its commands below "
        f"{torques} N*m under any moment within {float(level):.4g} of {moment} N*m"
    )


def _largest_level(evidence: dict[str, Any], norms: list[AxisNorms]) -> tuple[Fraction, Box]:
    """Return the largest share of the moment, at most 1, whose box closes, and the box; an empty one if none does."""
    nothing = [[Fraction(0)] * len(SIGNALS) for _ in range(3)]
    whole = _grow_box(evidence, norms, Fraction(1), nothing)
    if whole:
        return Fraction(1), whole
    low, high = Fraction(0), Fraction(1)
    best: Box = []
    while high - low > max(_TOLERANCE * high, _MIN_LEVEL):
        middle = (low + high) / 2
        box = _grow_box(evidence, norms, middle, best or nothing)
        if box:
            low, best = middle, box
        else:
            high = middle
    return low, best


def _grow_box(evidence: dict[str, Any], norms: list[AxisNorms], level: Fraction, box: Box) -> Box:
    """Grow `box` until it closes and return it; an empty box if it does not settle within the limits.

    The map is convex and grows with the box: once the steps lengthen, they lengthen for good.
    """
    limits = [Fraction(limit) * COMMAND_SHARE for limit in evidence["law"]["limits"]]
    sizes = [sum(map(sum, box))]
    for _ in range(_ROUNDS):
        try:
            follows = map_box(evidence, norms, level, box)
        except ValueError:  # an angle is above 1 rad; later rounds only add to it
            return []
        if any(row[SIGNALS.index("command")] > limit for row, limit in zip(box, limits, strict=True)):
            return []
        if max(rate_shares(evidence, box)) > COMMAND_SHARE:
            return []
        if _is_inside(follows, box):
            return box
        box = [[Fraction(float(value * (1 + _GROWTH))) for value in row] for row in follows]
        sizes.append(sum(map(sum, box)))
        if len(sizes) > _MIN_ROUNDS and sizes[-1] - sizes[-2] > sizes[-2] - sizes[-3]:
            return []
    return []


def _is_inside(inner: Box, outer: Box) -> bool:
    pairs = (pair for rows in zip(inner, outer, strict=True) for pair in zip(*rows, strict=True))
    return all(value <= bound for value, bound in pairs)


def _is_invariant(level: Fraction, evidence: dict[str, Any], norms: list[AxisNorms]) -> bool:
    try:
        return bool(check_box(level, evidence, norms))
    except Refusal:
        return False


def _slack(evidence: dict[str, Any], norms: list[AxisNorms], level: Fraction, box: Box) -> float:
    """Return the least relative distance between a bound of the box and the bound that follows from it."""
    follows = map_box(evidence, norms, level, box)
    pairs = [pair for rows in zip(follows, box, strict=True) for pair in zip(*rows, strict=True)]
    return min(float(1 - value / bound) for value, bound in pairs if bound)
