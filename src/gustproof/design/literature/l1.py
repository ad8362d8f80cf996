"""L1 adaptive control with the piecewise-constant adaptation law.

    u = J rate_p (angle_p (reference - attitude) - rate) - C sigma

A predictor of the rate, `x' = -rate_p (x - rate) + (torque + sigma) / J`, runs on the torque that a model of the
actuator computes. At each sample `sigma` becomes the moment that would have brought its error to 0 over the last one:
`sigma = -J exp(-rate_p dt) (x - rate) rate_p / (1 - exp(-rate_p dt))`. The low-pass `C` of first order separates
adaptation from robustness. Without projection, which this law does not need, all of this is linear.

References
----------
N. Hovakimyan, C. Cao, L1 Adaptive Control Theory: Guaranteed Robustness with Fast Adaptation, SIAM 2010, chapter 3:
piecewise-constant adaptation laws.
"""

import math
from dataclasses import dataclass

from gustproof.airframe.covariance import AxisModel
from gustproof.design.literature.structure import AxisStructure, low_pass, modelled_torque, newest_attitude
from gustproof.design.loops.filters import SampledAxisLoop
from gustproof.design.loops.settings import LoopSignals


@dataclass(frozen=True, slots=True, kw_only=True)
class L1Gains:
    """Gains of one axis, all positive."""

    angle_p: float
    """[1/s] commanded rate per attitude error."""
    rate_p: float
    """[1/s] angular acceleration per rate error; the pole of the predictor too."""
    cutoff: float
    """[rad/s] corner of the low-pass."""


def build_l1(gains: L1Gains, model: AxisModel) -> LoopSignals:
    """Return the loop of one axis."""
    dt, inertia = model.plant.dt, model.inertia
    loop = SampledAxisLoop(dt)
    torque, take_command = modelled_torque(loop, model)
    predicted = loop.state()
    keep = math.exp(-gains.rate_p * dt)
    held = (1.0 - keep) / gains.rate_p  # [s] of a constant acceleration over a sample
    sigma = -inertia * keep / held * (predicted - loop.rate)
    loop.set_next(predicted, keep * predicted + (1.0 - keep) * loop.rate + held / inertia * (torque + sigma))
    commanded = gains.angle_p * (loop.reference - newest_attitude(loop))
    command = inertia * gains.rate_p * (commanded - loop.rate) - loop.smooth(sigma, low_pass(gains.cutoff, dt))
    take_command(command)
    return LoopSignals(loop, command, commanded, None)


def _start(speed: float) -> L1Gains:
    return L1Gains(angle_p=3.0 * speed, rate_p=8.0 * speed, cutoff=4.0 * speed)


L1 = AxisStructure(
    design="L1 adaptive control with piecewise-constant adaptation (Hovakimyan, Cao)",
    start=_start,
    bounds=(L1Gains(angle_p=1.0, rate_p=1.0, cutoff=1.0), L1Gains(angle_p=50.0, rate_p=1e3, cutoff=1e3)),
    build=build_l1,
)
"""Law `l1`."""
