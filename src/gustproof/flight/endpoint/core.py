"""Samples in, commands out: a law steps once a sample; a repeated sample gets the same command again."""

import math
from collections.abc import Sequence

import numpy as np

from firmware_model.mavlink.frames import RejectReason
from firmware_model.mavlink.wire import MOST_TURNS, LockstepLine
from firmware_model.types import AttitudeTarget, Command, ImuSample, TorqueCommand, Vector
from gustproof.flight.controllers.stepper import CheckedStepper
from gustproof.flight.endpoint.attitude import SlowAttitude
from gustproof.flight.endpoint.exchange import LawTurns
from gustproof.law.form import Law, Output
from gustproof.law.step import LawStepper

Flown = Law | CheckedStepper
"""Law, or a user's controller that has been made."""
References = Sequence[tuple[int, Vector]]
_CORRECTION_RATE = 5.0  # [1/s]; a hundred times the leak of a law's estimate
_LONGEST_CORRECTION_S = 0.1
_LONGEST_GAP_US = 1_000_000  # a longer silence is no motion to interpolate


def sample_time(law: Flown) -> float:
    """Return the sample time [s] of a law or a user's controller.

    Raises
    ------
    ValueError
        If the controller takes any, and none has been set.
    """
    if law.dt is None:
        raise ValueError(f"controller '{law.name}' has no sample time")
    return law.dt


class UserStepper:
    """A user's controller in flight, with the methods of `gustproof.law.step.LawStepper`."""

    def __init__(self, entry: CheckedStepper, dt: float, scale: Vector) -> None:
        self._entry, self._dt, self._scale = entry, dt, scale
        self._bound = 1.0 if entry.output is Output.TORQUE else math.inf
        self._reference = np.zeros(3)
        self.restart()

    def restart(self, _attitude: Vector | None = None) -> None:
        """Return to the initial state; the reference stays."""
        self._entry.reset()

    def correct(self, attitude: Vector, share: float) -> None:
        """Do nothing: a user's controller keeps its attitude to itself."""

    def set_reference(self, euler: Vector) -> None:
        """Set the attitude to hold from the next step on: roll, pitch, yaw [rad]."""
        self._reference = np.array(euler)

    def step(self, gyro_B: Vector, force_B: Vector) -> Vector:
        """Step with rates [rad/s] and specific force [m/s^2]; return the command as float32 fractions of `scale`."""
        command = self._entry.step(np.array(gyro_B), self._reference.copy(), np.array(force_B), self._dt)
        bound = self._bound
        x, y, z = (
            float(np.float32(min(max(each / one, -bound), bound)))
            for each, one in zip(command, self._scale, strict=True)
        )
        return x, y, z


class ControllerCore:
    """A law or a user's controller in flight, from its initial state with all states 0.

    A law knows no attitude but the one that it integrates: its level is the attitude in which it begins.

    `scale` is the command that is 1.0 on the wire: the published torque limits [N*m] B for torques, 1 rad/s for rates.
    The command is divided by it and rounded to float32, as on every other route. `thrust` is sent beside rates, at
    first the published hover thrust; beside torques the vehicle holds its height.

    `missed` counts samples that the vehicle took between two steps of the law and that never came. The law's attitude
    lacks the rotation in that time, unless the law is `interpolating`. It then steps at instants of its own, `dt`
    apart, on gyro and force interpolated between samples: any stamps at nearly its rate will do.

    `earth_rate_N` [rad/s] is the turn of the earth, known where an estimator has taken all but that from the rates.

    `tilt` [rad] is the roll and pitch to hold from the next sample on, if the vehicle's position loop asks for them. Of
    the references then only the yaw counts.

    `references` are rising stamps [us], each with the attitude to hold from that sample on: roll, pitch, yaw [rad];
    level before the first. If the law is interpolating, they count from the last sample that reset it.
    """

    def __init__(self, law: Flown, scale: Vector, thrust: float, references: References = ()) -> None:
        self.thrust = thrust
        self._law: LawStepper | UserStepper
        self._law = LawStepper(law, scale) if isinstance(law, Law) else UserStepper(law, sample_time(law), scale)
        self.torque = law.output is Output.TORQUE
        self.interpolating = False
        self.last_sample_us = -1
        self.missed = 0
        self._sample_us = round(sample_time(law) * 1e6)
        self.fractions: Vector = (0.0, 0.0, 0.0)
        self._due_us = np.array([time_us for time_us, _ in references], dtype=np.int64)
        self._references = np.array([attitude for _, attitude in references]).reshape(-1, 3)
        self._begun = np.zeros(1, dtype=np.int64)
        self._clock = np.zeros(2, dtype=np.int64)
        self._began_us = self._step_at_us = 0
        self._before: tuple[float, ...] = (0.0,) * 6
        self.tilt: tuple[float, float] | None = None
        self._attitude: SlowAttitude | None = None
        self.earth_rate_N: Vector | None = None

    def answer(
        self, sample: ImuSample, *, reset: bool = False, attitude: Vector | None = None
    ) -> Command | RejectReason:
        """Return the command for a sample; the law steps if the sample is newer than the last one.

        With `reset` the law restarts first: another flew the vehicle until now. It starts at `attitude` [rad], if
        given and if it has an attitude estimate; its heading is 0 there.
        """
        time_us = sample.time_us
        if time_us < self.last_sample_us:
            return RejectReason.STALE
        if time_us > self.last_sample_us:
            if reset:
                self._law.restart(attitude)
                self._attitude = SlowAttitude(attitude) if attitude else None
                self.last_sample_us = -1
                self._began_us = time_us if self.interpolating else 0
            self.step(time_us, sample.gyro_B, sample.specific_force_B)
        return self.command(time_us, self.fractions)

    def correct(self, attitude: Vector, step_s: float) -> None:
        """Correct the law's attitude estimate by the autopilot's [rad], `step_s` after the last correction.

        The autopilot knows gravity and north: a law that integrates the gyro alone drifts, faster where samples are
        lost. The law follows a `SlowAttitude`; without a start there is none, and no correction.
        """
        if self._attitude is not None:
            step_s = min(step_s, _LONGEST_CORRECTION_S)
            self._attitude.correct(attitude, self.earth_rate_N, step_s)
            self._law.correct(self._attitude.angles, _CORRECTION_RATE * step_s)

    def command(self, time_us: int, fractions: Vector) -> Command:
        """Return `fractions` of `scale` as the command for the sample with this stamp."""
        if self.torque:
            return TorqueCommand(time_us=time_us, torque_B=fractions, throttle=None)
        return AttitudeTarget(time_us=time_us, q_NB=None, omega_B=fractions, thrust=self.thrust)

    def step(self, time_us: int, gyro_B: Vector, force_B: Vector) -> None:
        """Step the law with a newer sample; its command is `fractions` of `scale`."""
        self._set_reference(time_us)
        before_us, self.last_sample_us = self.last_sample_us, time_us
        if time_us - before_us != self._sample_us and before_us >= 0:
            self.missed += max(round((time_us - before_us) / self._sample_us) - 1, 0)
        if self._attitude is not None:
            self._attitude.add(gyro_B, 1e-6 * (time_us - before_us))
        if self.interpolating:
            self._interpolate(before_us, time_us, (*gyro_B, *force_B))
        else:
            self.fractions = self._law.step(gyro_B, force_B)

    @property
    def exchanges(self) -> bool:
        """True if its next steps can be made in machine code: those of a law, at the instants of the samples."""
        return isinstance(self._law, LawStepper) and not self.interpolating and self._attitude is None and not self.tilt

    def begin_turns(self, line: LockstepLine) -> LawTurns:
        """Return what `answer_samples` needs, if it `exchanges`."""
        assert isinstance(self._law, LawStepper)
        line.given.values[3] = math.nan if self.torque else self.thrust
        own = self._law.packed, self._due_us, self._references, self._begun
        return LawTurns(MOST_TURNS, self.torque, self.last_sample_us, self._sample_us, *own, line, self._clock)

    def end_turns(self, begun: LawTurns) -> None:
        """Go on after samples that were answered."""
        self.last_sample_us += begun.line.turns * self._sample_us
        x, y, z = begun.line.given.values[:3].tolist()
        self.fractions = x, y, z

    def _set_reference(self, time_us: int) -> None:
        """Let the law hold the newest attitude that is due."""
        due, since_us = self._begun[0], time_us - self._began_us
        while due < len(self._due_us) and self._due_us[due] <= since_us:
            x, y, z = self._references[due].tolist()
            self._law.set_reference((x, y, z))
            self._begun[0] = due = due + 1
        if self.tilt is not None:
            self._law.set_reference((*self.tilt, float(self._references[due - 1, 2]) if due else 0.0))

    def _interpolate(self, before_us: int, time_us: int, now: tuple[float, ...]) -> None:
        """Step the law at its own instants up to half a step after this sample."""
        gap_us = time_us - before_us
        if before_us < 0 or gap_us > _LONGEST_GAP_US:
            self._step_at_us, self._before, gap_us = time_us, now, 1
        while self._step_at_us <= time_us + self._sample_us // 2:
            share = min(max((self._step_at_us - time_us) / gap_us + 1.0, 0.0), 1.0)
            p, q, r, x, y, z = (old + share * (new - old) for old, new in zip(self._before, now, strict=True))
            self.fractions = self._law.step((p, q, r), (x, y, z))
            self._step_at_us += self._sample_us
        self._before = now
