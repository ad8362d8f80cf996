"""Loops of one axis, put together from their signals and digital filters.

A filter of the second order is a `Biquad`. One of the first order is `y = y1 + alpha (x - y1)`, where 1 counts samples
back.
"""

import math

import numpy as np

from firmware_model.config.gyro_filters import Biquad
from gustproof.law.cascade import AxisLaw, limit_by_reference
from gustproof.law.form import Matrix

_SIZE = 256  # states that an axis may have; more than any parameters ask for


def smoothing(cutoff: float, rate: float) -> float:
    """Return a new sample's weight [-] in a low-pass with a corner at `cutoff` [Hz], by the backward rule; 1 at 0."""
    return 1.0 / (1.0 + rate / (2.0 * math.pi * cutoff)) if cutoff > 0.0 else 1.0


class SampledAxisLoop:
    """Loop of one axis: its signals are rows over states, gyro [rad/s] and reference [rad].

    It begins with strapdown: `attitude` [rad] and `last_rate` [rad/s] of the previous sample, so that the attitude is
    that of the previous sample too. Estimators of autopilots end after their rate loops: these act on such an attitude.
    """

    def __init__(self, dt: float) -> None:
        self.dt = dt
        self._next: list[Matrix] = []
        self._excess: list[float] = []
        self.rate, self.reference = _unit(_SIZE), _unit(_SIZE + 1)
        self.attitude, self.last_rate = self.state(), self.state()
        self.set_next(self.attitude, self.attitude + 0.5 * dt * (self.rate - self.last_rate))
        self.set_next(self.last_rate, self.rate)

    def state(self) -> Matrix:
        """Return the signal of a new state."""
        self._next.append(np.zeros(_SIZE + 2))
        self._excess.append(0.0)
        return _unit(len(self._next) - 1)

    def set_next(self, state: Matrix, signal: Matrix, excess: float = 0.0) -> None:
        """Set what a state becomes: a signal, and `excess` times the command's saturation excess [N*m]."""
        at = int(np.argmax(state))
        self._next[at], self._excess[at] = signal, excess

    def delay(self, signal: Matrix) -> Matrix:
        """Return the signal as it was one sample before."""
        state = self.state()
        self.set_next(state, signal)
        return state

    def smooth(self, signal: Matrix, alpha: float) -> Matrix:
        """Return a signal after a filter of the first order; 1 is none."""
        if alpha == 1.0:
            return signal
        state = self.state()
        out = state + alpha * (signal - state)
        self.set_next(state, out)
        return out

    def apply_filter(self, signal: Matrix, biquad: Biquad) -> Matrix:
        """Return a signal after a filter of the second order; its states equal the signal at rest."""
        b0, b1, b2, a1, a2 = biquad
        gain = 1.0 + a1 + a2
        older, old = self.state(), self.state()
        new = gain * signal - a1 * old - a2 * older
        self.set_next(old, new)
        self.set_next(older, old)
        return (b0 * new + b1 * old + b2 * older) / gain

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self._next)

    def law(self, command: Matrix, commanded: Matrix, limit: float | None, order: int) -> AxisLaw:
        """Return the law of the axis, with states that do nothing up to `order` ones.

        Parameters
        ----------
        command
            Signal of the torque [N*m].
        commanded
            Signal of the rate commanded from attitude [rad/s]: the only one with the reference.
        limit
            [rad/s] largest commanded rate; `None` for none.
        order
            Number of states, as many as there are or more.
        """
        n = order
        kept = [*range(n), _SIZE, _SIZE + 1]
        rows = np.zeros((n, n + 2))
        rows[: self.order] = np.array(self._next)[:, kept]
        H = np.zeros((n, 1))
        H[: self.order, 0] = self._excess
        B, D = rows[:, n:], command[kept][None, n:]
        limited = limit_by_reference(commanded[kept], B, D, limit)
        A, C, G = rows[:, :n], command[kept][None, :n], self.dt * np.eye(n, 1)
        return AxisLaw(A=A, B=B, C=C, D=D, G=G, H=H, rate_limit=limited)


def _unit(at: int) -> Matrix:
    signal = np.zeros(_SIZE + 2)
    signal[at] = 1.0
    return signal
