"""Linear response of a law to a step of its attitude reference."""

import math
from dataclasses import dataclass

import numpy as np

from firmware_model.config.vehicle import Vehicle
from gustproof.airframe.hover import reference_loop
from gustproof.airframe.lpv import linear_plant, rate_loop
from gustproof.law.form import Law
from gustproof.robust.lti.state_space import Matrix, delay, discretize_zoh, series

_DURATION_S = 15.0


@dataclass(frozen=True, slots=True, kw_only=True)
class StepInfo:
    """A step response in four numbers, each of the worst axis."""

    rise_time_s: float
    """[s] from 10 % to 90 %; infinite if 90 % is not reached."""
    overshoot: float
    """[-] largest excess over the step, as a fraction of it."""
    settling_time_s: float
    """[s] last time outside 5 % of the step; infinite if it ends outside."""
    final_error: float
    """[-] largest error in the last sample, as a fraction of the step."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StepResponse:
    """Response of each angle to a unit step of its own reference."""

    time: Matrix
    """(k,) [s]."""
    attitude: Matrix
    """(k, 3) [-] phi, theta, psi per radian of step."""

    def step_info(self) -> StepInfo:
        """Return rise time, overshoot, settling time and final error, each of the worst axis."""
        return StepInfo(
            rise_time_s=max(self._rise_time(axis) for axis in range(3)),
            overshoot=max(float(np.max(self.attitude)) - 1.0, 0.0),
            settling_time_s=max(self._settling_time(axis) for axis in range(3)),
            final_error=float(np.max(np.abs(self.attitude[-1] - 1.0))),
        )

    def _rise_time(self, axis: int) -> float:
        low, high = (np.nonzero(self.attitude[:, axis] >= level)[0] for level in (0.1, 0.9))
        return float(self.time[high[0]] - self.time[low[0]]) if high.size else math.inf

    def _settling_time(self, axis: int) -> float:
        outside = np.nonzero(np.abs(self.attitude[:, axis] - 1.0) > 0.05)[0]
        if not outside.size:
            return 0.0
        return math.inf if outside[-1] == self.time.size - 1 else float(self.time[outside[-1] + 1])


def step_response(law: Law, vehicle: Vehicle, *, tau: float | None = None) -> StepResponse:
    """Return the linear response of the vehicle, without leak, to a step of each reference, command one sample late.

    The law is taken within its limits. For a law that commands rates, `tau` [s] is the lag of the autopilot's rate
    loop.
    """
    plant = linear_plant(vehicle) if tau is None else rate_loop(vehicle, leak=0.0, tau=tau)
    commanded = plant.subsystem(slice(None), slice(0, 3))
    sampled = series(delay(3, law.dt), discretize_zoh(commanded, law.dt))
    closed = reference_loop(law, sampled)
    samples = round(_DURATION_S / law.dt)
    attitude = np.empty((samples, 3))
    for axis in range(3):
        x = np.zeros(closed.order)
        for k in range(samples):
            attitude[k, axis] = closed.C[axis] @ x + closed.D[axis, axis]
            x = closed.A @ x + closed.B[:, axis]
    return StepResponse(time=np.asarray(law.dt * np.arange(samples), dtype=np.float64), attitude=attitude)
