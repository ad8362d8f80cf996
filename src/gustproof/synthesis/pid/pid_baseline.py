"""The baseline PID: the strapdown cascade of least attitude error in turbulence, at given sensitivity and slew."""

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.law.cascade import AxisLaw, Gains, cascade_law, gain_parameters, strapdown_axis
from gustproof.law.form import Law, Provenance
from gustproof.performance.covariance import AxisModel, axis_models
from gustproof.synthesis.pid.tuning import SENSITIVITY_PEAK, SLEW, tune
from gustproof.version import __version__

_START = Gains(angle_p=4.0, rate_p=8.0, rate_i=16.0, rate_d=0.3, derivative_cutoff=30.0)
"""Start of the search: low gains, stable for an actuator lag up to .05 s."""


def tune_baseline(vehicle: Vehicle, scenario: Scenario, *, sensitivity_peak: float, slew: float) -> list[Gains]:
    """Return the gains of roll, pitch and yaw with the least attitude error, pooled over the axes.

    The result is a local optimum from one fixed start: the same gains every time. The scenario gives turbulence, delay,
    sample time and duration. The sensitivity peak [-] of each axis is at most `sensitivity_peak`. The rms torque slew
    pooled over the axes is at most `slew` [N*m/s].

    Raises
    ------
    DesignError
        If no such gains are found: the limits are too tight for this vehicle.
    """

    def axis(gains: Gains, model: AxisModel) -> AxisLaw:
        return strapdown_axis(gains, model.inertia, scenario.dt)

    models = axis_models(vehicle, scenario)
    return tune(models, axis, _START, "cascade", sensitivity_peak=sensitivity_peak, slew=slew)


def baseline_pid(vehicle: Vehicle, scenario: Scenario) -> Law:
    """Return the law with the gains of `tune_baseline`; its provenance has gains and limits."""
    gains = tune_baseline(vehicle, scenario, sensitivity_peak=SENSITIVITY_PEAK, slew=SLEW)
    limit, dt = vehicle.stabilizer.rate_limit, scenario.dt
    axes = [strapdown_axis(each, J, dt, limit) for each, J in zip(gains, vehicle.inertia_B, strict=True)]
    provenance = Provenance(
        design=f"strapdown cascade, gains of least attitude error in scenario '{scenario.name}'",
        vehicle=vehicle.name,
        parameters={"sensitivity_peak": SENSITIVITY_PEAK, "slew_nm_per_s": SLEW, **gain_parameters(gains)},
        version=__version__,
    )
    return cascade_law("pid-fair", axes, vehicle, scenario.dt, provenance)
