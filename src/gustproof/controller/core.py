"""Samples in, commands out: a law that steps once a sample, and answers a repeated sample as it did before."""

import numpy as np

from firmware_model.frames import Dropped
from firmware_model.signals import AttitudeTarget, Command, ImuSample, TorqueCommand, Vector
from gustproof.law import Law, Output, step

HOVER_THRUST = 0.5
"""[0..1] thrust sent with every command; the simulated vehicle's position is held."""


class Controller:
    """A law in flight, level as its reference, from its stated initial state: all states 0.

    `scale` is what 1.0 on the wire means: the published torque limits [N*m] B for torques, 1 rad/s for rates. The
    command is divided by it and rounded to float32, here as in every other route.
    """

    def __init__(self, law: Law, scale: Vector) -> None:
        self._law = law
        self._scale = np.array(scale)
        self._x = np.zeros(law.order)
        self._y = np.zeros(6)
        self._answer: Command | None = None
        self._answered_us = -1

    def answer(self, sample: ImuSample) -> Command | Dropped:
        """Return the command for a sample; the law steps if it is newer than the last one."""
        if self._answer is None or sample.time_us > self._answered_us:
            self._y[:3] = sample.gyro_B
            self._x, command = step(self._law, self._x, self._y)
            self._answer = self._command(sample.time_us, command)
            self._answered_us = sample.time_us
        elif sample.time_us < self._answered_us:
            return Dropped.STALE
        return self._answer

    def _command(self, time_us: int, command: np.ndarray[tuple[int], np.dtype[np.float64]]) -> Command:
        roll, pitch, yaw = (command / self._scale).astype(np.float32).tolist()
        if self._law.output is Output.TORQUE:
            return TorqueCommand(time_us=time_us, torque_B=(roll, pitch, yaw), throttle=HOVER_THRUST)
        return AttitudeTarget(time_us=time_us, q_NB=None, omega_B=(roll, pitch, yaw), thrust=HOVER_THRUST)
