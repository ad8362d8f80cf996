"""The messages of each sample, packed and read by pymavlink and by us, with equal bytes."""

import math

from pymavlink.dialects.v20 import all as wire
from table import Action, Bench, in_turns

from firmware_model.mavlink import messages
from firmware_model.mavlink.channel import Channel
from firmware_model.mavlink.frames import Frame, parse

_STAMP, _FORCE, _RATE, _TORQUE = 4000, (0.5, 0.25, -9.75), (0.125, 0.25, 0.5), (0.125, 0.25, 0.5)


def measure(bench: Bench) -> None:
    """Measure packing and reading of the two messages of a sample."""
    times = 200 if bench.quick else 5_000
    for name, seconds in in_turns(_their_actions(times) | _our_actions(times), 1 if bench.quick else 7).items():
        bench.row(name, "us a message", [value / times / 2 * 1e6 for value in seconds])


def _make_datagrams() -> tuple[bytes, bytes]:
    """Return a sample and its command."""
    sample = messages.imu_template(1).make(0, _STAMP, *_FORCE, *_RATE)
    return sample, messages.torque_template(1).make(0, _STAMP, *_TORQUE, math.nan)


def _their_actions(times: int) -> dict[str, Action]:
    """Return packing and reading by pymavlink."""
    datagrams, link = _make_datagrams(), wire.MAVLink(None, 1, 1)

    def pack() -> None:
        for _ in range(times):
            wire.MAVLink_highres_imu_message(_STAMP, *_FORCE, *_RATE, 0, 0, 0, 0, 0, 0, 0, 0x3F).pack(link)
            controls = (*_TORQUE, math.nan, 0.0, 0.0, 0.0, 0.0)
            wire.MAVLink_set_actuator_control_target_message(_STAMP, 0, 1, 1, controls).pack(link)

    def read() -> None:
        for _ in range(times):
            for datagram in datagrams:
                wire.MAVLink(None).parse_buffer(bytearray(datagram))

    return {"pymavlink packs": pack, "pymavlink reads": read}


def _our_actions(times: int) -> dict[str, Action]:
    """Return packing and reading by us, in Python."""
    samples, torques, channel = messages.imu_template(1), messages.torque_template(1), Channel(1, 1)
    sample, command = _make_datagrams()

    def pack() -> None:
        for _ in range(times):
            channel.make(samples, _STAMP, *_FORCE, *_RATE)
            channel.make(torques, _STAMP, *_TORQUE, math.nan)

    def read() -> None:
        for _ in range(times):
            for datagram in (sample, command):
                (frame,) = parse(datagram)
                if isinstance(frame, Frame):
                    _ = messages.parse_imu(frame) if datagram is sample else messages.parse_command(frame, 1)

    return {"we pack": pack, "we read": read}
