"""Predict a box that the true Euler angles leave with at most a stated risk, in stated air and gyro noise.

**Gaussian.** In the linear model of `predict` every signal of a flight from rest is Gaussian with mean 0. Its deviation
sigma_k at sample k follows from the covariance, step by step, so the start and a gyro's random walk count as they are.

**Union bound.** A signal is beyond b at sample k with the probability `2 Q(b / sigma_k) = erfc(b / (sigma_k sqrt(2)))`.
The sum over samples and axes bounds the probability of ever being beyond, however samples depend on each other
(Boole's inequality). Risk is split equally over the axes.

**Between samples** an angle leaves its chord by at most `h^2 / 8` times its largest second derivative. That is bounded
by boxes of rate, torque and moment, which get a hundredth of the risk together with the command's. Torque runs
monotonically from one sample to the next toward the acting command. The moment of the air is held over a sample.

**Not a proof.** Second order is neglected: exact kinematics, gyroscopic coupling and scheduling. So are angular gusts,
which act through rate damping alone, the law's limit of commanded rate, and rounding. The command's limits are checked:
a law whose command may reach them within the risk is refused.
"""

import math
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import scipy

from firmware_model.config.scenario import AccelerometerFault, GyroFault, Scenario
from firmware_model.config.vehicle import NoiseModel, Vehicle
from firmware_model.config.waveforms import Dryden
from gustproof.airframe.covariance import axis_models, initial_covariance
from gustproof.airframe.predict import close_vehicle
from gustproof.law.form import Law, Matrix, Output

_PATH_SHARE = 0.01
"""[-] share of the risk for what happens between samples, and for the command's limits."""
_MOST_SAMPLES = 1_000_000
"""Samples of the longest flight that is predicted, some ten seconds of work."""
_LARGEST_DEG = 20.0
"""[deg] largest box of small angles; at it a cosine is 6 % below 1, and the model is no longer the vehicle's."""
_ANGLE, _RATE, _TORQUE, _COMMAND = range(4)
"""States of an axis, the first four of `augmented_axis`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeBox:
    """A box that the true Euler angles leave with the stated probability at most, in the linear model."""

    attitude_deg: list[float]
    """[deg] bounds of |phi|, |theta|, |psi| over the whole flight."""
    risk: float
    """[-] probability, at most, that any of them is exceeded at any time."""
    horizon_s: float
    """[s] duration of the flight."""
    assumes: dict[str, Any]
    """Assumptions by name."""


def attitude_box(law: Law, vehicle: Vehicle, scenario: Scenario, risk: float) -> AttitudeBox:
    """Return the least box of the true Euler angles at a `risk` [-] that the union bound gives, see the module.

    Raises
    ------
    ValueError
        If risk is no probability, the law commands rates, or scenario or vehicle have more than turbulence and white
        gyro noise. Or if the flight is too long, the command may reach its limits, or the box is not one of small
        angles.

    References
    ----------
    G. Boole, An Investigation of the Laws of Thought, 1854 (the union bound).
    """
    if not 0.0 < risk < 1.0:
        raise ValueError(f"risk is {risk}, must be a probability between 0 and 1")
    _check_scope(law, vehicle, scenario)
    sigmas = sample_deviations(law, vehicle, scenario)
    held = [math.sqrt((m.gust.C @ m.gust_covariance @ m.gust.C.T).item()) for m in axis_models(vehicle, scenario)]
    each, h = risk / 3.0, scenario.dt
    box = []
    for axis, sigma in enumerate(sigmas.transpose(1, 2, 0)):
        moments = np.full(scenario.samples, held[axis])
        signals = (sigma[_RATE], sigma[_TORQUE], moments, sigma[_COMMAND])
        rate, torque, moment, command = (least_bound(each_of, _PATH_SHARE * each / 4.0) for each_of in signals)
        limit = min(law.limits[axis], vehicle.torque_limit[axis])
        if not command < limit:
            raise ValueError(
                f"the command on axis {axis} may reach {command:.3g} N*m at this risk, its limit {limit:g}"
            )
        drag = vehicle.rate_damping_B[axis]
        # between samples the rate grows by h / 2 times its derivative, which contains that rate's drag
        turned = ((torque + moment) / vehicle.inertia_B[axis] + drag * rate) / (1.0 - drag * h / 2.0)
        box.append(math.degrees(least_bound(sigma[_ANGLE], (1.0 - _PATH_SHARE) * each) + h * h / 8.0 * turned))
    if max(box) > _LARGEST_DEG:
        raise ValueError(
            f"the box reaches {max(box):.3g} deg: a model of small angles predicts {_LARGEST_DEG:g} at most"
        )
    return AttitudeBox(
        attitude_deg=box, risk=risk, horizon_s=scenario.duration_s, assumes=_assumptions(vehicle, scenario)
    )


def sample_deviations(law: Law, vehicle: Vehicle, scenario: Scenario) -> Matrix:
    """Return the standard deviations (N + 1, 3, 4) of all axes at each sample, from rest to the end.

    The signals are true angle [rad], rate [rad/s], torque and last command [N*m]. Initially the air is stationary and
    all else at rest. The loop need not be stable.
    """
    models = axis_models(vehicle, scenario)
    closed = close_vehicle(models, law, vehicle, scenario)
    P, starts = initial_covariance(models, closed.order)
    Q = closed.B @ closed.B.T
    rows = np.add.outer(starts, np.arange(4))
    variances = np.empty((scenario.samples + 1, 3, 4))
    with np.errstate(over="ignore", invalid="ignore"):  # a loop that diverges has no finite deviation
        for k in range(len(variances)):
            variances[k] = P.diagonal()[rows]
            P = closed.A @ P @ closed.A.T + Q
        return np.asarray(np.sqrt(variances))


def exceedance(sigmas: Matrix, bound: float) -> float:
    """Return the union bound of the probability that any of Gaussian numbers of mean 0 is beyond `bound`.

    `sigmas` (N,) are their standard deviations, which may be 0. The result may be above 1.
    """
    moving = sigmas[sigmas > 0.0]
    # Rounding of `erfc` and of the sum is far below the factor.
    return float(np.sum(scipy.special.erfc(bound / (math.sqrt(2.0) * moving)))) * (1.0 + 1e-9)


def least_bound(sigmas: Matrix, risk: float) -> float:
    """Return the least bound whose `exceedance` is at most `risk`, to a relative 1e-9, rounded up by bisection.

    Raises
    ------
    ValueError
        If a deviation is not finite, as in a loop that diverges.
    """
    if not np.all(np.isfinite(sigmas)):
        raise ValueError("the loop diverges within the horizon: a deviation is not finite")
    # 2 Q(z) <= exp(-z^2 / 2), so that the upper end suffices
    low, high = 0.0, float(np.max(sigmas)) * math.sqrt(2.0 * math.log(2.0 * len(sigmas) / risk))
    while high - low > 1e-9 * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if exceedance(sigmas, middle) <= risk else (middle, high)
    return high


def _check_scope(law: Law, vehicle: Vehicle, scenario: Scenario) -> None:
    """Refuse what is not in the linear model, rather than leave it out in silence."""
    if law.output is not Output.TORQUE:
        raise ValueError(f"law '{law.name}' commands rates, which the autopilot's own loop tracks: give a torque law")
    only = replace(
        scenario,
        translation="held",
        initial_attitude_deg=(0.0, 0.0, 0.0),
        wind=tuple(item for item in scenario.wind if isinstance(item, Dryden)),
        moment=(),
        link=(),
        event=(),
        gyro=GyroFault(noise=scenario.gyro.noise),
        accelerometer=AccelerometerFault(noise=scenario.accelerometer.noise),
    )
    others = [each.name for each in fields(scenario) if getattr(only, each.name) != getattr(scenario, each.name)]
    if others:
        keys = ", ".join(others)
        only_air = "only 'dryden' turbulence on a level stand is predicted"
        raise ValueError(f"scenario '{scenario.name}': {only_air}, not its {keys}")
    if any(vehicle.gyro.bias_B) or vehicle.gyro.noise_model is not NoiseModel.CONSTANT:
        raise ValueError(
            f"vehicle '{vehicle.name}': a gyro with a bias, or noise that is not constant, is no white noise"
        )
    if scenario.samples > _MOST_SAMPLES:
        raise ValueError(f"the flight has {scenario.samples:,} samples, at most {_MOST_SAMPLES:,} are predicted")


def _assumptions(vehicle: Vehicle, scenario: Scenario) -> dict[str, Any]:
    dryden = next(item for item in scenario.wind if isinstance(item, Dryden))
    return {
        "model": "linear at level attitude, from rest; a prediction, not a proof",
        "probability": "Gaussian tails, summed over samples and axes; between samples by the second derivative",
        "air": f"{dryden.specification}, {dryden.wind_speed_20ft:g} m/s at 20 ft, stationary",
        "gust_scale": scenario.gust_scale,
        "moment_between_samples": "held",
        "noise_rad_s": axis_models(vehicle, scenario)[0].noise,
        "sample_time_s": scenario.dt,
        "delay_samples": scenario.delay_samples,
        "inertia_kg_m2": list(vehicle.inertia_B),
        "actuator_lag_s": vehicle.actuator_lag,
        "neglected": "second order in the angles, the limit of commanded rate, rounding"
        + ("" if vehicle.rate_damping is None else ", angular gusts"),
    }
