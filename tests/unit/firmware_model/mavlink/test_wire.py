"""Frames in kernels: made and read as by templates and the parser; what differs anywhere is not the expected one."""

import math

import numpy as np
import pytest

from firmware_model.mavlink import messages
from firmware_model.mavlink.frames import FrameTemplate
from firmware_model.mavlink.wire import (
    NO_SOCKET,
    LockstepLine,
    finish_frame,
    give_frame,
    is_expected,
    make_line,
    move_frame,
    read_stamp,
    take_frame,
)

TEMPLATES = [
    (messages.imu_template(1), 2**63 - 1, (0.5, -9.75, 2.0, 0.25, -0.125, 0.0)),
    (messages.torque_template(3), 4000, (0.25, -0.5, 1.0, math.nan)),
    (messages.rate_template(254), 2**32 - 1, (0.25, -40.0, 1.0, 0.75)),
]
each_template = pytest.mark.parametrize(("template", "stamp", "numbers"), TEMPLATES)


def put(template: FrameTemplate, datagram: bytes):
    wire = template.buffer()
    wire.frame[: len(datagram)] = np.frombuffer(datagram, dtype=np.uint8)
    return wire


@each_template
@pytest.mark.parametrize("sequence", [0, 7, 255])
def test_a_frame_is_made_as_by_its_template_and_read_again(template, stamp, numbers, sequence):
    datagram, made = template.make(sequence, stamp, *numbers), template.buffer()
    made.values[:] = numbers
    finish_frame(made, sequence, stamp)
    assert made.frame[: made.model.size].tobytes() == datagram
    taken = put(template, datagram)
    assert is_expected(taken, len(datagram), sequence)
    assert read_stamp(taken) == stamp
    assert taken.values.tobytes() == np.array(numbers, dtype=np.float32).tobytes()
    other = template.buffer()
    move_frame(made, other)
    assert is_expected(other, len(datagram), sequence)


@each_template
def test_what_differs_in_a_bit_a_byte_or_its_number_is_not_expected(template, stamp, numbers):
    datagram = template.make(7, stamp, *numbers)
    assert not is_expected(put(template, datagram), len(datagram), 8)
    for size in (-1, 0, len(datagram) - 1, len(datagram) + 1, 65_535):
        assert not is_expected(put(template, datagram), size, 7)
    number = int.from_bytes(datagram, "little")
    for bit in range(8 * len(datagram)):
        flipped = (number ^ 1 << bit).to_bytes(len(datagram), "little")
        assert not is_expected(put(template, flipped), len(datagram), 7)
    foreign = messages.torque_template(4).make(7, stamp, 0.0, 0.0, 0.0, 0.0)
    assert not is_expected(put(template, foreign), len(foreign), 7)


def make(peer: tuple[str, int] = ("127.0.0.1", 14580)) -> LockstepLine:
    return make_line(messages.torque_template(1).buffer(), messages.imu_template(1).buffer(), peer)


def test_a_turn_takes_one_frame_gives_another_and_counts_both():
    line = make()
    assert line.address == (0, ("127.0.0.1", 14580))
    line.begin(255, 254)
    datagram = messages.torque_template(1).make(255, 4000, 0.0, 0.0, 0.0, 0.0)
    assert not line.put(datagram[:-1])
    assert line.put(datagram)
    assert take_frame(NO_SOCKET, line)
    line.given.values[:] = 1.0, 2.0, 3.0, 4.0, 5.0, 6.0
    give_frame(NO_SOCKET, line, 0, 8000)
    assert (line.turns, line.left) == (1, None)
    assert line.answer == messages.imu_template(1).make(254, 8000, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    assert line.log[0, 0, : len(datagram)].tobytes() == datagram
    assert line.log[1, 0, : len(line.answer)].tobytes() == line.answer
    assert not take_frame(NO_SOCKET, line)  # the next one has number 0
    assert line.left is not None
    assert line.left[0] == datagram


def test_a_peer_without_an_address_is_served_without_a_socket():
    assert make(("vehicle", 1)).address == (0, ("0.0.0.0", 1))
