"""Samples in, commands out: a law steps once a sample; a repeated sample gets the same command again."""

from collections import deque
from collections.abc import Sequence

from firmware_model.mavlink.frames import RejectReason
from firmware_model.types import AttitudeTarget, Command, ImuSample, TorqueCommand, Vector
from gustproof.law.form import Law, Output
from gustproof.law.step import LawStepper

References = Sequence[tuple[int, Vector]]


class Controller:
    """A law in flight, from its initial state with all states 0.

    A law knows no attitude but the one that it integrates: its level is the attitude in which it begins.

    `scale` is the command that is 1.0 on the wire: the published torque limits [N*m] B for torques, 1 rad/s for rates.
    The command is divided by it and rounded to float32, as on every other route. `hover` is the published thrust sent
    beside rates; beside torques the vehicle holds its height.

    `missed` counts samples that the vehicle took between two steps of the law and that never came. The law's attitude
    lacks the rotation in that time.

    `references` are rising stamps [us], each with the attitude to hold from that sample on: roll, pitch, yaw [rad];
    level before the first.
    """

    def __init__(self, law: Law, scale: Vector, hover: float, references: References = ()) -> None:
        self.hover = hover
        self._law = LawStepper(law, scale)
        self.torque = law.output is Output.TORQUE
        self.last_sample_us = -1
        self.missed = 0
        self._sample_us = round(law.dt * 1e6)
        self.fractions: Vector = (0.0, 0.0, 0.0)
        self._references = deque(references)

    def answer(self, sample: ImuSample, *, reset: bool = False) -> Command | RejectReason:
        """Return the command for a sample; the law steps if the sample is newer than the last one.

        With `reset` the law restarts from its initial state first: another flew the vehicle until now.
        """
        time_us = sample.time_us
        if time_us < self.last_sample_us:
            return RejectReason.STALE
        if time_us > self.last_sample_us:
            if reset:
                self._law.restart()
                self.last_sample_us = -1
            self.step(time_us, sample.gyro_B, sample.specific_force_B)
        return self.command(time_us, self.fractions)

    def command(self, time_us: int, fractions: Vector) -> Command:
        """Return `fractions` of `scale` as the command for the sample with this stamp."""
        if self.torque:
            return TorqueCommand(time_us=time_us, torque_B=fractions, throttle=None)
        return AttitudeTarget(time_us=time_us, q_NB=None, omega_B=fractions, thrust=self.hover)

    def step(self, time_us: int, gyro_B: Vector, force_B: Vector) -> None:
        """Step the law with a newer sample; its command is `fractions` of `scale`."""
        while self._references and self._references[0][0] <= time_us:
            self._law.set_reference(self._references.popleft()[1])
        if time_us - self.last_sample_us != self._sample_us and self.last_sample_us >= 0:
            self.missed += max(round((time_us - self.last_sample_us) / self._sample_us) - 1, 0)
        self.last_sample_us = time_us
        self.fractions = self._law.step(gyro_B, force_B)
