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
from dataclasses import asdict, dataclass

import numpy as np

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.law.cascade import AxisLaw, cascade_law, limit_by_reference
from gustproof.law.discretize import tustin
from gustproof.law.form import Law, Provenance
from gustproof.lti.state_space import Lti
from gustproof.performance.covariance import AxisModel, axis_models
from gustproof.synthesis.pid.tuning import tune
from gustproof.version import __version__

_START = (4.0, 8.0, 8.0, 0.7)
"""Start of the search: low gains, stable for an actuator lag up to .05 s."""


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


def indi_axis(
    gains: IndiGains, inertia: float, lag: float, delay_samples: int, dt: float, rate_limit: float | None = None
) -> AxisLaw:
    """Return INDI on strapdown attitude for one axis.

    The first two states are Euler angle [rad] and rate [rad/s] at the previous sample, as in `strapdown_axis`. Then
    follow the filters of gyro (2) and torque (2), the torque of the actuator's model [N*m], and the delayed commands
    [N*m], the newest first.

    The filters are trapezoidal, so the newest sample acts at once; the actuator is exact for a held command. The model
    receives the command after the torque limit, so it does not wind up.

    Parameters
    ----------
    gains
        Gains of the axis.
    inertia
        [kg*m^2] moment of inertia.
    lag
        [s] time constant of the actuator.
    delay_samples
        Samples from a measurement to the action of its command.
    dt
        [s] sample time.
    rate_limit
        [rad/s] largest rate commanded from attitude; none by default. The excess changes the reference.
    """
    n = 7 + delay_samples
    states, inputs = np.split(np.eye(n + 2), [n])  # rows over (states, rate, reference)
    E, omega, torque = states[0], states[1], states[6]
    rate, angle_reference = inputs
    corner = 2.0 * math.pi * gains.cutoff
    A, B = np.array([[0.0, 1.0], [-(corner**2), -2.0 * gains.damping * corner]]), np.array([[0.0], [corner**2]])
    low_pass = tustin(Lti(A=A, B=B, C=np.eye(2), D=np.zeros((2, 1))), dt)
    acceleration = low_pass.C[1] @ states[2:4] + low_pass.D[1, 0] * rate
    filtered_torque = low_pass.C[0] @ states[4:6] + low_pass.D[0, 0] * torque
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
            low_pass.A @ states[2:4] + low_pass.B @ rate[None],
            low_pass.A @ states[4:6] + low_pass.B @ torque[None],
            decay * torque + (1.0 - decay) * commands[-1],
            commands[:-1],
        ]
    )
    H = np.zeros((n, 1))
    H[7 if delay_samples else 6] = 1.0 if delay_samples else 1.0 - decay
    B, D, C = step[:, n:], command[None, n:], command[None, :n]
    limit = limit_by_reference(commanded, B, D, rate_limit)
    return AxisLaw(A=step[:, :n], B=B, C=C, D=D, G=dt * np.eye(n, 1), H=H, rate_limit=limit)


def tune_indi(
    vehicle: Vehicle, scenario: Scenario, *, sensitivity_peak: float = 1.36, slew: float = 19.9
) -> tuple[IndiGains, IndiGains, IndiGains]:
    """Return the gains of roll, pitch and yaw with the least attitude error, by the search of the baseline PID.

    See `gustproof.synthesis.pid.pid_baseline.tune_baseline` for the parameters.

    Raises
    ------
    DesignError
        If no such gains are found: the limits are too tight for this vehicle.
    """

    def axis(values: list[float], model: AxisModel) -> AxisLaw:
        return indi_axis(
            _unpack_gains(values), model.inertia, vehicle.actuator_lag, scenario.delay_samples, scenario.dt
        )

    models = axis_models(vehicle, scenario)
    roll, pitch, yaw = tune(models, axis, _START, "INDI", sensitivity_peak=sensitivity_peak, slew=slew)
    return _unpack_gains(roll), _unpack_gains(pitch), _unpack_gains(yaw)


def indi_law(
    vehicle: Vehicle, scenario: Scenario, *, name: str = "indi", sensitivity_peak: float = 1.36, slew: float = 19.9
) -> Law:
    """Return the law with the gains of `tune_indi`; its provenance has gains and limits.

    Raises
    ------
    DesignError
        See `tune_indi`.
    """
    gains = tune_indi(vehicle, scenario, sensitivity_peak=sensitivity_peak, slew=slew)
    axes = [
        indi_axis(
            each, inertia, vehicle.actuator_lag, scenario.delay_samples, scenario.dt, vehicle.stabilizer.rate_limit
        )
        for each, inertia in zip(gains, vehicle.inertia_B, strict=True)
    ]
    provenance = Provenance(
        design="incremental nonlinear dynamic inversion on strapdown attitude, "
        f"gains of least attitude error in scenario '{scenario.name}'",
        vehicle=vehicle.name,
        parameters={
            "sensitivity_peak": sensitivity_peak,
            "slew_nm_per_s": slew,
            **{
                f"{axis}_{key}": value
                for axis, each in zip(("roll", "pitch", "yaw"), gains, strict=True)
                for key, value in asdict(each).items()
            },
        },
        version=__version__,
    )
    return cascade_law(name, axes, vehicle, scenario.dt, provenance)


def _unpack_gains(values: list[float]) -> IndiGains:
    angle_p, rate_p, cutoff, damping = values
    return IndiGains(angle_p=angle_p, rate_p=rate_p, cutoff=cutoff, damping=damping)
