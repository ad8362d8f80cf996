"""The geometric PID with lead: a filtered angular acceleration beside the published terms, see `geometric`."""

from firmware_model.config.vehicle import Vehicle
from gustproof.baselines.geometric import CUTOFF, GeometricGains, GeometricPid, geometric_axis
from gustproof.baselines.tuned_gains import design_vehicle, find_gains, start_speeds, tune_axes
from gustproof.law.cascade import AxisLaw
from gustproof.performance.covariance import AxisModel


def tune_lead(vehicle: Vehicle) -> list[GeometricGains]:
    """Return the gains of the law with lead by the procedure of `tuned_gains`, in a few seconds.

    Raises
    ------
    DesignError
        If no gains are within the limits.
    """
    starts = [
        GeometricGains(
            attitude=32.0 * v * v, rate=8.0 * v, integral=16.0 * v * v, acceleration=0.3, cutoff=min(CUTOFF * v, 60.0)
        )
        for v in start_speeds(vehicle)
    ]

    def axis(gains: GeometricGains, model: AxisModel) -> AxisLaw:
        return geometric_axis(gains, model.inertia, model.plant.dt)

    return tune_axes(vehicle, axis, starts, "geometric PID with lead")


def find_lead(vehicle: Vehicle) -> list[GeometricGains]:
    """Return the gains of roll, pitch and yaw, shipped or tuned."""
    return find_gains("geometric_lead", vehicle, tune_lead, GeometricGains)


def make(vehicle: Vehicle) -> GeometricPid:
    """Return the law with lead for a vehicle; one that is not shipped is tuned first, in a few seconds."""
    vehicle = design_vehicle(vehicle)
    return GeometricPid(vehicle, find_lead(vehicle))
