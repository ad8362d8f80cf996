"""Lockstep in machine code: a set-point in, a sample flown, the next one out, for as long as nothing else happens.

Any datagram but the one that is expected ends it, and is left to `VehicleEndpoint`, which decides what it means.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_model.mavlink.messages import imu_template, torque_template
from firmware_model.mavlink.wire import (
    MOST_TURNS,
    NO_SOCKET,
    FrameBuffer,
    LockstepLine,
    give_frame,
    make_line,
    read_stamp,
    take_frame,
)
from firmware_model.numerics.compiled import compiled, kernel
from firmware_model.recording.journal import FORCE_B, GYRO_B, WIDTH
from firmware_model.sim import step
from firmware_model.sim.inner_loop import THRUST, TORQUE
from firmware_model.sim.vehicle_loop import LoopArrays, VehicleLoop
from firmware_model.types import AttitudeTarget, Command, TorqueCommand

_AGE, _MODE = WIDTH - 2, WIDTH - 1


class SampleTurns(NamedTuple):
    """Samples to fly, on what comes from a controller."""

    turns: int
    """Samples at most."""
    kind: float
    """[-] kind of the set-points, `TORQUE` or `RATES`."""
    mode: int
    """Mode for the records."""
    sample: int
    """Number of the first sample."""
    loop: LoopArrays
    """The vehicle."""
    line: LockstepLine
    """LockstepLine to its controller."""
    records: NDArray[np.float64]
    """(MOST_TURNS, n) records that are flown."""


def load_exchange(loop: VehicleLoop) -> None:
    """Load or compile the machine code."""
    line = make_line(torque_template(1).buffer(), imu_template(1).buffer(), ("127.0.0.1", 0))
    fly_samples(NO_SOCKET, SampleTurns(0, TORQUE, 0, 0, loop.arrays(), line, np.empty((MOST_TURNS, 1))))


@compiled
def fly_samples(socket: int, samples: SampleTurns) -> None:
    """Fly samples, each on the set-point that answers it and comes on the socket; send the next one after each."""
    for turn in range(samples.turns):
        if not fly_sample(socket, samples, turn):
            return


@kernel
def fly_sample(socket: int, samples: SampleTurns, turn: int) -> bool:
    """Fly the sample of a turn, and return true; return false, and leave all as it is, unless its answer comes.

    The record is that of `VehicleLoop.advance`, and the frame that of `firmware_model.mavlink.messages`.
    """
    loop, line, sample_us, sample = samples.loop, samples.line, samples.loop.sim.sample_us, samples.sample + turn
    late, time_us, values = loop.stamps_us.size, sample * sample_us, line.given.values
    if not (take_frame(socket, line) and _read_setpoint(samples.kind, line.taken, time_us, loop, sample % late)):
        return False
    acting = (sample + 1) % late
    step.advance(loop.sim, sample, loop.setpoints[acting], loop.record)
    loop.record[_AGE] = (time_us - loop.stamps_us[acting]) // sample_us
    loop.record[_MODE] = samples.mode
    for i in range(loop.record.size):
        samples.records[turn, i] = loop.record[i]
    step.observe(loop.sim, sample + 1, loop.record)
    for i in range(3):
        values[i], values[3 + i] = loop.record[FORCE_B + i], loop.record[GYRO_B + i]
    give_frame(socket, line, turn, time_us + sample_us)
    return True


@kernel
def _read_setpoint(kind: float, wire: FrameBuffer, time_us: int, loop: LoopArrays, place: int) -> bool:
    """Write the set-point in `wire` to its place; return whether it answers the sample, with nothing to clip or reject.

    The result equals that of `firmware_model.mavlink.messages.parse_command`.
    """
    x, y, z = np.float64(wire.values[0]), np.float64(wire.values[1]), np.float64(wire.values[2])
    thrust, stamp = np.float64(wire.values[3]), read_stamp(wire)
    if kind == TORQUE:
        fits = stamp == time_us and abs(x) <= 1.0 and abs(y) <= 1.0 and abs(z) <= 1.0 and math.isnan(thrust)
    else:
        fits = stamp == time_us // 1000 & 0xFFFF_FFFF and math.isfinite(x + y + z) and 0.0 <= thrust <= 1.0
        stamp = 1000 * stamp
    if fits:
        row = loop.setpoints[place]
        for i in range(row.size):
            row[i] = 0.0
        row[0], row[1], row[2], row[3], row[THRUST] = kind, x, y, z, thrust
        loop.stamps_us[place] = stamp
    return bool(fits)


def read_command(loop: LoopArrays, sample: int) -> Command:
    """Return the command of a controller that came at a sample."""
    place = sample % len(loop.stamps_us)
    kind, x, y, z, *_, thrust = loop.setpoints[place].tolist()
    time_us = int(loop.stamps_us[place])
    if kind == TORQUE:
        return TorqueCommand(time_us, (x, y, z), None)
    return AttitudeTarget(time_us, None, (x, y, z), thrust)
