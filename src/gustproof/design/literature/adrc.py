"""Active disturbance rejection control (ADRC), linear, by bandwidths.

    u = (rate_p^2 (angle_p (reference - attitude) - z1) - 2 rate_p z2 - z3) / b,      b = 1 / (inertia_ratio J lag)

From command to rate the axis is of second order. So the extended state observer estimates the rate as `z1` and its
derivative as `z2`. All that changes this other than the command is `z3`: gusts, damping, the lag's own pole. It knows
nothing of the vehicle but `b`. All of its poles are at `observer`, those of the rate at `rate_p`.

References
----------
J. Han, From PID to active disturbance rejection control, IEEE Transactions on Industrial Electronics 56 (2009),
900-906.
Z. Gao, Scaling and bandwidth-parameterization based controller tuning, American Control Conference 2003.
R. Miklosovic, A. Radke, Z. Gao, Discrete implementation and generalization of the extended state observer, American
Control Conference 2006: the current discrete estimator.
"""

import math
from dataclasses import dataclass

import numpy as np

from gustproof.airframe.covariance import AxisModel
from gustproof.design.literature.structure import AxisStructure, actuator_lag, newest_attitude
from gustproof.design.loops.filters import SampledAxisLoop
from gustproof.design.loops.settings import LoopSignals


@dataclass(frozen=True, slots=True, kw_only=True)
class AdrcGains:
    """Gains of one axis, all positive."""

    angle_p: float
    """[1/s] commanded rate per attitude error."""
    rate_p: float
    """[rad/s] bandwidth of the rate."""
    observer: float
    """[rad/s] bandwidth of the observer."""
    inertia_ratio: float
    """[-] inertia that the law takes the axis to have, over its own."""


def build_adrc(gains: AdrcGains, model: AxisModel) -> LoopSignals:
    """Return the loop of one axis."""
    dt, beta = model.plant.dt, math.exp(-gains.observer * model.plant.dt)
    b = 1.0 / (gains.inertia_ratio * model.inertia * actuator_lag(model))
    chain = np.array([[1.0, dt, 0.5 * dt**2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
    loop = SampledAxisLoop(dt)
    before = np.array([loop.state() for _ in range(3)])  # predicted for the new sample
    entry = np.array([1.0 - beta**3, 1.5 * (1.0 - beta) ** 2 * (1.0 + beta) / dt, (1.0 - beta) ** 3 / dt**2])
    z = before + np.outer(entry, loop.rate - before[0])
    commanded = gains.angle_p * (loop.reference - newest_attitude(loop))
    command = (gains.rate_p**2 * (commanded - z[0]) - 2.0 * gains.rate_p * z[1] - z[2]) / b
    for state, signal, share in zip(before, chain @ z, (0.5 * dt**2 * b, dt * b, 0.0), strict=True):
        loop.set_next(state, signal + share * command, share)
    return LoopSignals(loop, command, commanded, None)


def _start(speed: float) -> AdrcGains:
    return AdrcGains(angle_p=3.5 * speed, rate_p=45.0 * speed, observer=28.0 * speed, inertia_ratio=0.6)


ADRC = AxisStructure(
    design="active disturbance rejection control with an extended state observer (Han; Gao)",
    start=_start,
    bounds=(
        AdrcGains(angle_p=1.0, rate_p=1.0, observer=1.0, inertia_ratio=0.1),
        AdrcGains(angle_p=50.0, rate_p=1e3, observer=1e3, inertia_ratio=10.0),
    ),
    build=build_adrc,
)
"""Law `adrc`."""
