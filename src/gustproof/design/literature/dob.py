"""Disturbance observer around a PD law.

    u = J rate_p (angle_p (reference - attitude) - rate) - Q (rate / P - u z^-delay),      P(s) = 1 / (J s (lag s + 1))

`Q` is a low-pass of second order, as many as `P` has poles, so that `Q / P` is proper. Both filters are trapezoidal.

References
----------
W.-H. Chen, J. Yang, L. Guo, S. Li, Disturbance-observer-based control and related methods: an overview, IEEE
Transactions on Industrial Electronics 63 (2016), 1083-1095: the observer in the frequency domain, due to K. Ohnishi.
"""

from dataclasses import dataclass

import numpy as np

from gustproof.airframe.covariance import AxisModel
from gustproof.design.literature.structure import (
    AxisStructure,
    actuator_lag,
    filter_signal,
    newest_attitude,
    sent_commands,
)
from gustproof.design.loops.filters import SampledAxisLoop
from gustproof.design.loops.settings import LoopSignals
from gustproof.robust.lti.bilinear import tustin
from gustproof.robust.lti.state_space import Lti


@dataclass(frozen=True, slots=True, kw_only=True)
class DobGains:
    """Gains of one axis, all positive."""

    angle_p: float
    """[1/s] commanded rate per attitude error."""
    rate_p: float
    """[1/s] angular acceleration per rate error."""
    cutoff: float
    """[rad/s] corner of `Q`."""
    damping: float
    """[-] damping of `Q`."""


def build_dob(gains: DobGains, model: AxisModel) -> LoopSignals:
    """Return the loop of one axis; the observer reckons with a delay of one sample at least."""
    dt, inertia, square = model.plant.dt, model.inertia, gains.cutoff**2
    lag = actuator_lag(model)
    loop = SampledAxisLoop(dt)
    sent, send = sent_commands(loop, max(model.delay_samples, 1))
    # states: output of Q and its slope
    A, B = np.array([[0.0, 1.0], [-square, -2.0 * gains.damping * gains.cutoff]]), np.array([[0.0], [square]])
    Q = Lti(A=A, B=B, C=np.eye(1, 2), D=np.zeros((1, 1)))
    inverse = Lti(A=A, B=B, C=inertia * (np.eye(1, 2, 1) + lag * A[1:]), D=inertia * lag * B[1:])
    disturbance = filter_signal(loop, tustin(inverse, dt), loop.rate) - filter_signal(loop, tustin(Q, dt), sent[-1])
    commanded = gains.angle_p * (loop.reference - newest_attitude(loop))
    command = inertia * gains.rate_p * (commanded - loop.rate) - disturbance
    send(command)
    return LoopSignals(loop, command, commanded, None)


def _start(speed: float) -> DobGains:
    return DobGains(angle_p=3.5 * speed, rate_p=8.0 * speed, cutoff=33.0 * speed, damping=1.2)


DOB = AxisStructure(
    design="disturbance observer around a PD law (Ohnishi)",
    start=_start,
    bounds=(
        DobGains(angle_p=1.0, rate_p=1.0, cutoff=1.0, damping=0.3),
        DobGains(angle_p=50.0, rate_p=1e3, cutoff=1e3, damping=5.0),
    ),
    build=build_dob,
)
"""Law `dob`."""
