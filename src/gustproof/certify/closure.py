"""Certified flight of the law that flies: sampled, one sample late, nonlinear, under any moment within a bound."""

import math
from fractions import Fraction
from typing import Any

from firmware_model.vehicle import Vehicle
from gustproof.certify.certificate import Certificate
from gustproof.certify.check import Refusal, closed
from gustproof.certify.enclosure import SIGNALS, Box, Norms, axis_norms, mapped
from gustproof.law import Law, Output

_ROUNDS = 400
"""Rounds in which a box grows; one that has not settled by then counts as open."""
_GROWTH = Fraction(1, 10**6)
"""[-] relative widening of a box in each round, so that it closes with slack."""
_HALVINGS = 14
"""Halvings of the interval of the part of the moment: to 1e-4."""


def certify_closure(
    law: Law,
    vehicle: Vehicle,
    *,
    moment: tuple[float, float, float],
    horizon: float,
    leak: float = 0.0,
    noise: float = 0.0,
    risk: float = 1e-3,
) -> Certificate:
    """Return a certificate of the largest part of `moment` under which the flight provably stays in a box.

    Nothing is assumed of rho: attitude, rates and estimates are bounded from the moment. The certificate's `gain` is
    the part, at most 1; its evidence holds the box.

    Parameters
    ----------
    law
        Torque law with three states an axis, roll, pitch, yaw in turn (a central controller), scheduled or not.
    vehicle
        Airframe; its gyro's noise is not taken, see `noise`.
    moment
        (3,) [N*m] B, bound of the disturbance moment about each axis, any function of time: it may even swing in step
        with the samples and turn the vehicle between them, where the gyro does not look.
    horizon
        [s] from rest and level attitude.
    leak
        [1/s] of the Euler kinematics; 0 is the true vehicle.
    noise
        [rad/s] rms of the white Gaussian noise of a gyro sample.
    risk
        [-] probability that the noise leaves its bounds; not used without noise.

    Raises
    ------
    ValueError
        If the law is of another form, or a number is out of range.
    """
    if law.order != 9 or law.output is not Output.TORQUE:
        raise ValueError(f"law '{law.name}' has {law.order} states, must command torque with three states an axis")
    if not (min(moment) >= 0.0 < max(moment) and horizon >= law.dt and leak >= 0.0 <= noise and 0.0 < risk < 1.0):
        raise ValueError("moment, horizon and risk must be positive, leak and noise not negative")
    samples = math.ceil(horizon / law.dt)
    count = 3 * (len(SIGNALS) + 3) * (samples + 1)
    evidence: dict[str, Any] = {
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
        },
        "samples": samples,
        "moment": list(moment),
        "noise": noise,
        "risk": risk,
        "deviations": math.sqrt(2.0 * math.log(count / risk)) + 1e-6,
        "box": [],
    }
    norms = [axis_norms(evidence, axis) for axis in range(3)]
    level, box = _largest(evidence, norms)
    evidence["box"] = [[float(value) for value in row] for row in box]
    proven = bool(box) and _closes(level, evidence, norms)
    return Certificate(
        statement=_statement(law, level, moment, horizon, box) if proven else "no part of the moment is covered",
        gain=float(level) if proven else None,
        lower_bound=0.0,
        proven=proven,
        assumes=_assumptions(law, moment, horizon, leak, noise, risk),
        evidence=evidence,
        residual=_slack(evidence, norms, level, box) if proven else None,
    )


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


def _largest(evidence: dict[str, Any], norms: list[Norms]) -> tuple[Fraction, Box]:
    """Return the largest part of the moment, at most 1, whose box closes, and the box; an empty one if none does."""
    whole = _settled(evidence, norms, Fraction(1))
    if whole:
        return Fraction(1), whole
    low, high, best = Fraction(0), Fraction(1), []
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        box = _settled(evidence, norms, middle)
        if box:
            low, best = middle, box
        else:
            high = middle
    return low, best


def _settled(evidence: dict[str, Any], norms: list[Norms], level: Fraction) -> Box:
    """Return the least box that closes, grown from nothing; an empty one if it does not settle."""
    box = [[Fraction(0)] * len(SIGNALS) for _ in range(3)]
    for _ in range(_ROUNDS):
        try:
            follows = mapped(evidence, norms, level, box)
        except ValueError:  # an angle is above 1 rad: it will not come back
            return []
        if all(
            value <= bound
            for row, inside in zip(follows, box, strict=True)
            for value, bound in zip(row, inside, strict=True)
        ):
            return box
        box = [[Fraction(float(value * (1 + _GROWTH))) for value in row] for row in follows]
    return []


def _closes(level: Fraction, evidence: dict[str, Any], norms: list[Norms]) -> bool:
    try:
        return bool(closed(level, evidence, norms))
    except Refusal:
        return False


def _slack(evidence: dict[str, Any], norms: list[Norms], level: Fraction, box: Box) -> float:
    """Return the least relative distance of a bound that follows from the box."""
    follows = mapped(evidence, norms, level, box)
    pairs = [pair for rows in zip(follows, box, strict=True) for pair in zip(*rows, strict=True)]
    return min(float(1 - value / bound) for value, bound in pairs if bound)
