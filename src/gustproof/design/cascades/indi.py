"""Incremental nonlinear dynamic inversion (INDI) in the common law form, the usual alternative to PID in autopilots.

The command is the present torque plus the torque for the missing angular acceleration:

    u = T_f + J (nu - domega_f),      nu = rate_p (angle_p (reference - E) - omega)

`domega_f` is the derivative of the low-passed gyro; `T_f` is the torque behind the same filter. Both refer to the same
instant, so their difference is the disturbance alone. The torque is not measured: a model of the actuator computes it
from the commands sent. Attitude is strapdown, as in `gustproof.law.cascade`.

References
----------
E. J. J. Smeur, Q. Chu, G. C. H. E. de Croon, Adaptive incremental nonlinear dynamic inversion for attitude control of
micro air vehicles, Journal of Guidance, Control, and Dynamics 39 (2016), 450-461.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.airframe.covariance import AxisModel
from gustproof.design.cascades.tuning import (
    FAIR_LIMITS,
    SLOWER,
    TuningLimits,
    axis_parameters,
    loop_speed,
    models_of_axes,
    tune,
)
from gustproof.law.cascade import AxisLaw, cascade_law, limit_by_reference
from gustproof.law.form import Law, Provenance
from gustproof.robust.lti.bilinear import tustin
from gustproof.robust.lti.state_space import Lti


@dataclass(frozen=True, slots=True, kw_only=True)
class IndiGains:
    """Gains of one axis.

    Raises
    ------
    ValueError
        If a gain is not positive and finite.
    """

    angle_p: float
    """[1/s] commanded rate per attitude error."""
    rate_p: float
    """[1/s] commanded angular acceleration per rate error."""
    cutoff: float
    """[Hz] corner of the second-order filter on the gyro's derivative and on the torque."""
    damping: float
    """[-] damping of that filter."""

    def __post_init__(self) -> None:
        """Check each gain."""
        for name, value in asdict(self).items():
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} is {value!r}, must be positive and finite")


def indi_start(speed: float) -> IndiGains:
    """Return the start of a search: low gains, stable for the actuator lag of that `loop_speed`."""
    return IndiGains(angle_p=4.0 * speed, rate_p=8.0 * speed, cutoff=min(8.0 * speed, 60.0), damping=0.7)


def low_pass(gains: IndiGains, dt: float) -> Lti:
    """Return the filter of one axis, to the low-passed signal and its derivative, by the trapezoidal rule."""
    corner = 2.0 * math.pi * gains.cutoff
    A, B = np.array([[0.0, 1.0], [-(corner**2), -2.0 * gains.damping * corner]]), np.array([[0.0], [corner**2]])
    return tustin(Lti(A=A, B=B, C=np.eye(2), D=np.zeros((2, 1))), dt)


def indi_axis(
    gains: IndiGains, inertia: float, lag: float, delay_samples: int, dt: float, rate_limit: float | None = None
) -> AxisLaw:
    """Return INDI on strapdown attitude for one axis.

    The first two states are Euler angle [rad] and rate [rad/s] at the previous sample, as in `strapdown_axis`. Then
    follow the filters of gyro (2) and torque (2), the torque of the actuator's model [N*m], and the delayed commands
    [N*m], the newest first.

    The filters are trapezoidal, so the newest sample acts at once; the actuator is exact for a held command. The model
    receives the command after the torque limit, so it does not wind up.

    `inertia` is in [kg*m^2], the time constant `lag` of the actuator and the sample time `dt` in [s]. A command acts
    `delay_samples` after its measurement.
    Beyond `rate_limit` [rad/s], if given, the excess of the rate commanded from attitude changes the reference.
    """
    n = 7 + delay_samples
    states, inputs = np.split(np.eye(n + 2), [n])  # rows over (states, rate, reference)
    E, omega, torque = states[0], states[1], states[6]
    rate, angle_reference = inputs
    filtered = low_pass(gains, dt)
    acceleration = filtered.C[1] @ states[2:4] + filtered.D[1, 0] * rate
    filtered_torque = filtered.C[0] @ states[4:6] + filtered.D[0, 0] * torque
    attitude = E + 0.5 * dt * (omega + rate)
    commanded = gains.angle_p * (angle_reference - attitude)
    nu = gains.rate_p * (commanded - rate)
    command = filtered_torque + inertia * (nu - acceleration)
    decay = math.exp(-dt / lag)
    commands = np.vstack([command, states[7:]])  # the last one acts
    step = np.vstack(
        [
            E - 0.5 * dt * omega + 0.5 * dt * rate,
            rate,
            filtered.A @ states[2:4] + filtered.B @ rate[None],
            filtered.A @ states[4:6] + filtered.B @ torque[None],
            decay * torque + (1.0 - decay) * commands[-1],
            commands[:-1],
        ]
    )
    H = np.zeros((n, 1))
    H[7 if delay_samples else 6] = 1.0 if delay_samples else 1.0 - decay
    B, D, C = step[:, n:], command[None, n:], command[None, :n]
    limit = limit_by_reference(commanded, B, D, rate_limit)
    return AxisLaw(A=step[:, :n], B=B, C=C, D=D, G=dt * np.eye(n, 1), H=H, rate_limit=limit)


def indi_law(
    vehicle: Vehicle,
    scenario: Scenario,
    *,
    name: str = "indi",
    limits: TuningLimits = FAIR_LIMITS,
    corners: Sequence[Vehicle] = (),
    gains: Sequence[IndiGains] | None = None,
) -> Law:
    """Return the law with `gains` of roll, pitch and yaw, by default those of least attitude error within the limits.

    The search is that of the baseline PID; the law's provenance has gains and limits. `corners` are vehicles off
    nominal, for the limit of the peak there.

    Raises
    ------
    DesignError
        If no such gains are found: the limits are too tight for this vehicle.
    """
    lag, delay, dt = vehicle.actuator_lag, scenario.delay_samples, scenario.dt

    def axis(gains: IndiGains, model: AxisModel) -> AxisLaw:
        return indi_axis(gains, model.inertia, lag, delay, dt)

    if gains is None:
        starts = [indi_start(slower * loop_speed(vehicle, scenario)) for slower in SLOWER]
        gains = tune(models_of_axes(vehicle, corners, scenario), axis, starts, "INDI", limits)
    limit = vehicle.stabilizer.rate_limit
    axes = [indi_axis(each, J, lag, delay, dt, limit) for each, J in zip(gains, vehicle.inertia_B, strict=True)]
    provenance = Provenance.of(
        vehicle,
        "incremental nonlinear dynamic inversion on strapdown attitude, "
        f"gains of least attitude error in scenario '{scenario.name}'",
        {**limits.parameters(), **axis_parameters(map(asdict, gains))},
    )
    return cascade_law(name, axes, vehicle, dt, provenance)
