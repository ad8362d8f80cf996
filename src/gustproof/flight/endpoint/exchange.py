"""A law's side of lockstep in machine code: a sample in, a step, its command out, for as long as nothing else happens.

Any datagram but the next sample ends it, and is left to `ControllerEndpoint`, which decides what it means.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_model.mavlink.messages import imu_template, torque_template
from firmware_model.mavlink.wire import NO_SOCKET, LockstepLine, give_frame, make_line, read_stamp, take_frame
from firmware_model.numerics.compiled import compiled, kernel
from firmware_model.numerics.libc import read_clock
from gustproof.law.step import PackedLaw, step_packed

_LONG_US = 200  # a wait after which several samples may have queued: which are late is decided elsewhere


class LawTurns(NamedTuple):
    """Samples to answer, as they come from a vehicle."""

    turns: int
    """Samples at most."""
    torque: bool
    """True if the commands are torques."""
    last_us: int
    """[us] stamp of the sample before the first."""
    sample_us: int
    """[us] from one sample to the next."""
    law: PackedLaw
    """The law."""
    due_us: NDArray[np.int64]
    """(n,) [us] rising stamps from which on the law holds another attitude."""
    references: NDArray[np.float64]
    """(n, 3) [rad] these attitudes: roll, pitch, yaw."""
    begun: NDArray[np.int64]
    """(1,) how many of them have been due."""
    line: LockstepLine
    """LockstepLine to the vehicle."""
    clock: NDArray[np.int64]
    """(2,) work space."""


def load_exchange(law: PackedLaw) -> None:
    """Load or compile the machine code."""
    line, none = make_line(imu_template(1).buffer(), torque_template(1).buffer(), ("127.0.0.1", 0)), np.zeros((0, 3))
    due_us, begun, clock = (np.zeros(size, dtype=np.int64) for size in (0, 1, 2))
    answer_samples(NO_SOCKET, LawTurns(0, True, 0, 1, law, due_us, none, begun, line, clock))


@compiled
def answer_samples(socket: int, answers: LawTurns) -> None:
    """Step a law with samples that come on a socket, and send each command."""
    since_us = read_clock(answers.clock)
    for turn in range(answers.turns):
        since_us = answer_sample(socket, answers, turn, since_us)
        if since_us < 0:
            return


@kernel
def answer_sample(socket: int, answers: LawTurns, turn: int, since_us: int) -> int:
    """Answer the sample of a turn, awaited since a time [us], and return when it came.

    Return a negative number, and leave all as it is, for any other datagram, and for a sample after a long wait. The
    bytes are those of `firmware_model.mavlink.messages`.
    """
    law, line, due_us, begun = answers.law, answers.line, answers.due_us, answers.begun
    taken, given, time_us = line.taken.values, line.given.values, answers.last_us + (turn + 1) * answers.sample_us
    if not take_frame(socket, line) or read_stamp(line.taken) != time_us:
        return -1
    x, y, z = np.float64(taken[0]), np.float64(taken[1]), np.float64(taken[2])
    p, q, r = np.float64(taken[3]), np.float64(taken[4]), np.float64(taken[5])
    now_us = since_us if socket == NO_SOCKET else read_clock(answers.clock)
    if now_us - since_us > _LONG_US or not math.isfinite(x + y + z + p + q + r):
        return -1
    while begun[0] < due_us.size and due_us[begun[0]] <= time_us:
        for i in range(3):
            law.memory[law.order + 3 + i] = answers.references[begun[0], i]
        begun[0] += 1
    given[0], given[1], given[2] = step_packed(law.ends, law.terms, law.kind, law.memory, p, q, r, x, y, z)
    give_frame(socket, line, turn, time_us if answers.torque else time_us // 1000 & 0xFFFF_FFFF)
    return now_us
