"""The baseline PID: the strapdown cascade of least attitude error in turbulence, at given sensitivity and slew."""

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.law.cascade import AxisLaw, Gains, cascade_law, gain_parameters, strapdown_axis
from gustproof.law.form import Law, Provenance
from gustproof.performance.covariance import AxisModel, axis_models
from gustproof.synthesis.pid.tuning import tune
from gustproof.version import __version__

_START = (4.0, 8.0, 16.0, 0.3, 30.0)
"""Start of the search: low gains, stable for an actuator lag up to .05 s."""


def tune_baseline(
    vehicle: Vehicle, scenario: Scenario, *, sensitivity_peak: float = 1.36, slew: float = 19.9
) -> tuple[Gains, Gains, Gains]:
    """Return the gains of roll, pitch and yaw with the least attitude error, pooled over the axes.

    The result is a local optimum from one fixed start: the same gains every time.

    Parameters
    ----------
    vehicle, scenario
        Vehicle and scenario to tune for; the scenario gives turbulence, delay, sample time and duration.
    sensitivity_peak
        [-] largest sensitivity peak of each axis.
    slew
        [N*m/s] largest rms torque slew, pooled over the three axes. The default keeps single flights, with their
        scatter, below 20.

    Raises
    ------
    DesignError
        If no such gains are found: the limits are too tight for this vehicle.
    """
    models = axis_models(vehicle, scenario)
    roll, pitch, yaw = tune(models, _make_axis, _START, "cascade", sensitivity_peak=sensitivity_peak, slew=slew)
    return _unpack_gains(roll), _unpack_gains(pitch), _unpack_gains(yaw)


def baseline_pid(
    vehicle: Vehicle, scenario: Scenario, *, name: str = "pid-fair", sensitivity_peak: float = 1.36, slew: float = 19.9
) -> Law:
    """Return the law with the gains of `tune_baseline`; its provenance has gains and limits.

    Raises
    ------
    DesignError
        See `tune_baseline`.
    """
    gains = tune_baseline(vehicle, scenario, sensitivity_peak=sensitivity_peak, slew=slew)
    axes = [
        strapdown_axis(each, inertia, scenario.dt, vehicle.stabilizer.rate_limit)
        for each, inertia in zip(gains, vehicle.inertia_B, strict=True)
    ]
    provenance = Provenance(
        design=f"strapdown cascade, gains of least attitude error in scenario '{scenario.name}'",
        vehicle=vehicle.name,
        parameters={"sensitivity_peak": sensitivity_peak, "slew_nm_per_s": slew, **gain_parameters(gains)},
        version=__version__,
    )
    return cascade_law(name, axes, vehicle, scenario.dt, provenance)


def _make_axis(values: list[float], model: AxisModel) -> AxisLaw:
    return strapdown_axis(_unpack_gains(values), model.inertia, model.plant.dt)


def _unpack_gains(values: list[float]) -> Gains:
    angle_p, rate_p, rate_i, rate_d, derivative_cutoff = values
    return Gains(angle_p=angle_p, rate_p=rate_p, rate_i=rate_i, rate_d=rate_d, derivative_cutoff=derivative_cutoff)
