"""Structure of one axis of a linear law, and the law of least attitude error that it makes for a vehicle.

All structures share strapdown attitude, the limit of the commanded rate, and one search: `design.cascades.tuning.tune`.
So a comparison of them compares structures.
"""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

from gustproof.airframe.covariance import AxisModel
from gustproof.design.cascades.tuning import SLOWER, TuningLimits, axis_parameters, loop_speed, models_of_axes, tune
from gustproof.design.loops.filters import SampledAxisLoop
from gustproof.design.loops.settings import LoopSignals
from gustproof.design.tune import TuningTask
from gustproof.law.cascade import AxisLaw, cascade_law
from gustproof.law.form import Law, Matrix, Provenance
from gustproof.robust.lti.state_space import Lti

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Record = TypeVar("Record", bound="DataclassInstance")


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisStructure(Generic[Record]):
    """Structure of one axis; its gains are a dataclass of positive numbers."""

    design: str
    """Words for a law's provenance."""
    start: Callable[[float], Record]
    """`loop_speed` [-] to the gains that a search starts with."""
    bounds: tuple[Record, Record]
    """Least and largest gains: an attitude that is held so weakly that only the gyro's drift gains by it is none."""
    build: Callable[[Record, AxisModel], LoopSignals]
    """Gains and the axis in turbulence to the loop."""

    def make(self, task: TuningTask, limits: TuningLimits) -> Law:
        """Return the law with the gains of least attitude error within the limits.

        Raises
        ------
        DesignError
            If no such gains are found.
        """
        vehicle, scenario = task.vehicle, task.scenario
        axes = models_of_axes(vehicle, task.corners, scenario)
        starts = [self.start(slower * loop_speed(vehicle, scenario)) for slower in SLOWER]
        gains = tune(axes, self._axis, starts, task.kind, limits, self.bounds)
        loops = [self.build(each, model) for each, (model, *_) in zip(gains, axes, strict=True)]
        order = max(each.loop.order for each in loops)
        built = [each.axis_law(order, vehicle.stabilizer.rate_limit) for each in loops]
        provenance = Provenance.of(
            vehicle,
            f"{self.design}, of least attitude error in scenario '{scenario.name}'",
            {**limits.parameters(), **axis_parameters(map(asdict, gains))},
        )
        return cascade_law(task.name, built, vehicle, scenario.dt, provenance)

    def _axis(self, gains: Record, model: AxisModel) -> AxisLaw:
        signals = self.build(gains, model)
        return signals.axis_law(signals.loop.order, None)


def actuator_lag(model: AxisModel) -> float:
    """Return the time constant [s] of the actuator of an axis."""
    return -model.plant.dt / math.log(float(model.plant.A[2, 2]))


def newest_attitude(loop: SampledAxisLoop) -> Matrix:
    """Return the signal of the strapdown attitude [rad] at the newest sample, by the trapezoidal rule."""
    return loop.attitude + 0.5 * loop.dt * (loop.last_rate + loop.rate)


def sent_commands(loop: SampledAxisLoop, count: int) -> tuple[list[Matrix], Callable[[Matrix], None]]:
    """Return signals of the last `count` commands [N*m], the newest first, and a function that takes the new one.

    They are commands as sent, after the torque limit.
    """
    sent = [loop.state() for _ in range(count)]

    def send(command: Matrix) -> None:
        for k, state in enumerate(sent):
            loop.set_next(state, sent[k - 1] if k else command, excess=0.0 if k else 1.0)

    return sent, send


def modelled_torque(loop: SampledAxisLoop, model: AxisModel) -> tuple[Matrix, Callable[[Matrix], None]]:
    """Return the signal of the torque [N*m] by a model of the actuator, and a function that takes the new command.

    The model is exact for a command held over a sample; it receives the command after the torque limit.
    """
    keep, torque = float(model.plant.A[2, 2]), loop.state()
    sent, send = sent_commands(loop, model.delay_samples)

    def take(command: Matrix) -> None:
        send(command)
        acting = sent[-1] if sent else command
        loop.set_next(torque, keep * torque + (1.0 - keep) * acting, excess=0.0 if sent else 1.0 - keep)

    return torque, take


def filter_signal(loop: SampledAxisLoop, system: Lti, signal: Matrix) -> Matrix:
    """Return a signal after a discrete system of one input and one output."""
    states = [loop.state() for _ in range(system.order)]
    for k, state in enumerate(states):
        loop.set_next(state, system.B[k, 0] * signal + sum(a * x for a, x in zip(system.A[k], states, strict=True)))
    return np.asarray(system.D[0, 0] * signal + sum(c * x for c, x in zip(system.C[0], states, strict=True)))


def low_pass(cutoff: float, dt: float) -> float:
    """Return the share of the new sample [-] in a first-order low-pass with a corner at `cutoff` [rad/s]."""
    return -math.expm1(-cutoff * dt)
