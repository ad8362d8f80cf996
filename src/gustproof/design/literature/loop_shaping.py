"""H-infinity loop shaping: weights give the loop its shape, a robust controller its margins.

The weights make a cascade of PI and angle P with a lead against the actuator's lag. From the rate it is
`W = J gain (1 + rate_i / s) (1 + angle_p / s) (1 + lag s) / (1 + s / cutoff)`. The
controller `K` of the shaped plant `W P` withstands coprime-factor uncertainty of `1 / gamma`, with `gamma` 1.1 times
its least. Plant and weights are sampled and delayed; the bilinear transformation makes them continuous and the
controller discrete again, and keeps `gamma`.

References
----------
D. McFarlane, K. Glover, A loop shaping design procedure using H-infinity synthesis, IEEE TAC 37 (1992), 759-769.
S. Skogestad, I. Postlethwaite, Multivariable Feedback Control, 2nd edition 2005, section 9.4: the formulas for plants
with feedthrough.
"""

from dataclasses import dataclass

import numpy as np

from gustproof.airframe.covariance import AxisModel
from gustproof.design.literature.structure import AxisStructure, actuator_lag, filter_signal, newest_attitude
from gustproof.design.loops.filters import SampledAxisLoop
from gustproof.design.loops.settings import LoopSignals
from gustproof.robust.coprime.ncfsyn import ncfsyn
from gustproof.robust.lti.bilinear import tustin
from gustproof.robust.lti.state_space import Lti, delay, series


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopShapingGains:
    """Weights of one axis, all positive."""

    angle_p: float
    """[1/s] commanded rate per attitude error."""
    gain: float
    """[1/s] angular acceleration per rate error."""
    rate_i: float
    """[1/s] corner of the PI."""
    cutoff: float
    """[rad/s] corner at which the lead ends."""


def shaped_plant(gains: LoopShapingGains, model: AxisModel) -> Lti:
    """Return the discrete plant of one axis from command [N*m] to the weighted rate, without its attitude."""
    dt, whole = model.plant.dt, model.plant
    system = Lti(A=whole.A[1:, 1:], B=whole.B[1:], C=whole.C[:, 1:], D=whole.D, dt=dt)
    for _ in range(model.delay_samples):
        system = series(delay(1, dt), system)
    for corner, gain in ((gains.angle_p, 1.0), (gains.rate_i, gains.gain * model.inertia)):
        system = series(system, _pi(corner, gain, dt))
    return series(system, _lead(gains, model))


def build_loop_shaping(gains: LoopShapingGains, model: AxisModel) -> LoopSignals:
    """Return the loop of one axis."""
    dt = model.plant.dt
    robust = ncfsyn(shaped_plant(gains, model)).lti
    loop = SampledAxisLoop(dt)
    commanded = gains.angle_p * (loop.reference - newest_attitude(loop))
    error, gain = commanded - loop.rate, gains.gain * model.inertia
    integral = loop.state()
    weighted = gain * (error + gains.rate_i * (integral + 0.5 * dt * error))
    loop.set_next(integral, integral + dt * error, excess=dt / gain)
    led = filter_signal(loop, _lead(gains, model), weighted)
    command = filter_signal(loop, robust, -led)
    return LoopSignals(loop, command, commanded, None)


def _pi(corner: float, gain: float, dt: float) -> Lti:
    """Return `gain (1 + corner / s)` by the trapezoidal rule."""
    return _first_order(0.0, gain * corner, gain, dt)


def _lead(gains: LoopShapingGains, model: AxisModel) -> Lti:
    """Return `(1 + lag s) / (1 + s / cutoff)` by the trapezoidal rule."""
    dt, corner = model.plant.dt, gains.cutoff
    lag = actuator_lag(model)
    return _first_order(corner, corner * (1.0 - lag * corner), lag * corner, dt)


def _first_order(pole: float, residue: float, through: float, dt: float) -> Lti:
    """Return `through + residue / (s + pole)` by the trapezoidal rule."""
    return tustin(Lti(A=np.array([[-pole]]), B=np.eye(1), C=np.array([[residue]]), D=np.array([[through]])), dt)


def _start(speed: float) -> LoopShapingGains:
    return LoopShapingGains(angle_p=4.0 * speed, gain=14.0 * speed, rate_i=8.0 * speed, cutoff=180.0 * speed)


LOOP_SHAPING = AxisStructure(
    design="H-infinity loop shaping of a PI cascade (McFarlane, Glover)",
    start=_start,
    bounds=(
        LoopShapingGains(angle_p=1.0, gain=1.0, rate_i=0.5, cutoff=10.0),
        LoopShapingGains(angle_p=50.0, gain=1e3, rate_i=50.0, cutoff=1e3),
    ),
    build=build_loop_shaping,
)
"""Law `loop-shaping`."""
