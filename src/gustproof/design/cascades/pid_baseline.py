"""The baseline PID: the strapdown cascade of least attitude error in turbulence, at given sensitivity and slew."""

from collections.abc import Sequence

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from gustproof.airframe.covariance import AxisModel
from gustproof.design.cascades.tuning import FAIR_LIMITS, SLOWER, TuningLimits, loop_speed, models_of_axes, tune
from gustproof.law.cascade import AxisLaw, Gains, cascade_law, gain_parameters, strapdown_axis
from gustproof.law.form import Law, Provenance


def _start(speed: float) -> Gains:
    """Return the start of a search: low gains, stable for the actuator lag of that `loop_speed`."""
    cutoff = min(30.0 * speed, 60.0)
    return Gains(angle_p=4.0 * speed, rate_p=8.0 * speed, rate_i=16.0 * speed**2, rate_d=0.3, derivative_cutoff=cutoff)


def tune_pid_gains(
    vehicle: Vehicle, scenario: Scenario, limits: TuningLimits, corners: Sequence[Vehicle] = ()
) -> list[Gains]:
    """Return the gains of roll, pitch and yaw with the least attitude error, pooled over the axes.

    The result is a local optimum from a few fixed starts: the same gains every time. The scenario gives turbulence,
    delay, sample time and duration. `corners` are vehicles off nominal, for the limit of the peak there.

    Raises
    ------
    DesignError
        If no such gains are found: the limits are too tight for this vehicle.
    """

    def axis(gains: Gains, model: AxisModel) -> AxisLaw:
        return strapdown_axis(gains, model.inertia, scenario.dt)

    starts = [_start(slower * loop_speed(vehicle, scenario)) for slower in SLOWER]
    return tune(models_of_axes(vehicle, corners, scenario), axis, starts, "cascade", limits)


def baseline_pid(
    vehicle: Vehicle,
    scenario: Scenario,
    *,
    name: str = "pid-fair",
    limits: TuningLimits = FAIR_LIMITS,
    corners: Sequence[Vehicle] = (),
    gains: Sequence[Gains] | None = None,
) -> Law:
    """Return the law with `gains`, by default those of `tune_pid_gains`; its provenance has gains and limits."""
    gains = tune_pid_gains(vehicle, scenario, limits, corners) if gains is None else gains
    limit, dt = vehicle.stabilizer.rate_limit, scenario.dt
    axes = [strapdown_axis(each, J, dt, limit) for each, J in zip(gains, vehicle.inertia_B, strict=True)]
    provenance = Provenance.of(
        vehicle,
        f"strapdown cascade, gains of least attitude error in scenario '{scenario.name}'",
        {**limits.parameters(), **gain_parameters(gains)},
    )
    return cascade_law(name, axes, vehicle, scenario.dt, provenance)
