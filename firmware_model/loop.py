"""Plant and on-board loop at their rates: the one place where commands are delayed and turned into set-points."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from firmware_model import plant
from firmware_model.journal import RECORD, WIDTH
from firmware_model.scenario import Scenario
from firmware_model.signals import AttitudeTarget, Command, ImuSample, Off, Quaternion, Setpoint, TorqueCommand, Vector
from firmware_model.vehicle import Vehicle

Array = NDArray[np.float64]
_MODE = WIDTH - 1
_IDLE = np.zeros(plant.SETPOINT)
_LEVEL = np.array([plant.ATTITUDE, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


class VehicleLoop:
    """A vehicle that flies a scenario sample by sample: `observe`, then `advance`, until `finished`.

    `sample` is the number of the current one, `time_us` [us] its model time.
    """

    def __init__(self, vehicle: Vehicle, scenario: Scenario, seed: int) -> None:
        self._world = plant.new_world(vehicle, scenario, seed)
        self._sample_us, self._samples = scenario.sample_us, scenario.samples
        self._record = np.empty(WIDTH)
        self._fields = self._record.view(RECORD)[0]
        self._imu: ImuSample | None = None
        self._pending = deque([_IDLE] * scenario.delay_samples)
        self.sample = 0
        self.time_us = 0

    @property
    def finished(self) -> bool:
        """Whether all samples of the scenario are flown."""
        return self.sample >= self._samples

    def observe(self) -> ImuSample:
        """Return what the sensors measure at this sample; the same object until `advance`."""
        if self._imu is None:
            world = self._world
            plant.observe(
                world.params, world.state, world.gusts, world.moments, world.seed, self.sample, self._sample_us,
                self._record,
            )  # fmt: skip
            _, p, q, r, f_x, f_y, f_z = self._record[:7].tolist()
            self._imu = ImuSample(time_us=self.time_us, gyro_B=(p, q, r), specific_force_B=(f_x, f_y, f_z))
        return self._imu

    def advance(self, setpoint: Setpoint, mode: int) -> Array:
        """Move to the next sample and return the journal record (WIDTH,) of this one, valid until the next call.

        A command of a controller acts `delay_samples` later. What the autopilot flies by itself acts at once, and
        commands that are still on their way are dropped.
        """
        self.observe()
        row = setpoint_of(setpoint)
        if isinstance(setpoint, Command):
            self._pending.append(row)
            row = self._pending.popleft()
        else:
            self._pending = deque([row] * len(self._pending))
        world = self._world
        plant.advance(
            world.params, world.state, world.seed, self.sample, self._sample_us, row, self._record
        )  # fmt: skip
        self._record[_MODE] = mode
        self.sample += 1
        self.time_us += self._sample_us
        self._imu = None
        return self._record

    @property
    def on_ground(self) -> bool:
        """Whether the ground carries the vehicle: never where its place is held."""
        return False

    @property
    def q_NB(self) -> Quaternion:
        """True attitude at the sample."""
        w, x, y, z = self._fields["q_NB"].tolist()
        return w, x, y, z

    @property
    def estimate_q_NB(self) -> Quaternion:
        """On-board strapdown attitude at the sample."""
        w, x, y, z = plant.estimate_q_NB(self._world.state).tolist()
        return w, x, y, z

    def truth(self, name: str) -> Vector:
        """Return a vector of the journal's record at the sample by its name, as `omega_B` or `gust_B`."""
        a, b, c = self._fields[name].tolist()
        return a, b, c


def setpoint_of(setpoint: Setpoint) -> Array:
    """Return a set-point as the row (SETPOINT,) that the kernels take."""
    if isinstance(setpoint, TorqueCommand):
        return np.array((plant.TORQUE, *setpoint.torque_B, 0.0, 0.0, 0.0, 0.0))
    if isinstance(setpoint, AttitudeTarget):
        return _target(setpoint)
    return _IDLE if isinstance(setpoint, Off) else _LEVEL


def _target(command: AttitudeTarget) -> Array:
    rates = command.omega_B or (0.0, 0.0, 0.0)
    if command.q_NB is None:
        return np.array([plant.RATES, *rates, 0.0, 0.0, 0.0, 0.0])
    return np.array([plant.ATTITUDE, *command.q_NB, *rates])
