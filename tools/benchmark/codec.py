"""The messages of each sample, packed and read: pymavlink's code beside ours, byte for byte the same frames."""

import math

from pymavlink.dialects.v20 import all as wire
from table import Action, Bench, in_turns

from firmware_model.mavlink import messages
from firmware_model.mavlink.channel import Channel
from firmware_model.mavlink.frames import Frame, parse

_STAMP, _FORCE, _RATE, _TORQUE = 4000, (0.5, 0.25, -9.75), (0.125, 0.25, 0.5), (0.125, 0.25, 0.5)


def measure(bench: Bench) -> None:
    """Measure both directions of a turn, once as a sender and once as a reader."""
    times = 200 if bench.quick else 5_000
    samples, torques = messages.imu_template(1), messages.torque_template(1)
    sample, command = samples.make(0, _STAMP, *_FORCE, *_RATE), torques.make(0, _STAMP, *_TORQUE, math.nan)
    theirs = wire.MAVLink(None, 1, 1)
    traffic = Channel(1, 1)

    def pymavlink_packs() -> None:
        for _ in range(times):
            wire.MAVLink_highres_imu_message(_STAMP, *_FORCE, *_RATE, 0, 0, 0, 0, 0, 0, 0, 0x3F).pack(theirs)
            controls = (*_TORQUE, math.nan, 0.0, 0.0, 0.0, 0.0)
            wire.MAVLink_set_actuator_control_target_message(_STAMP, 0, 1, 1, controls).pack(theirs)

    def pymavlink_reads() -> None:
        for _ in range(times):
            wire.MAVLink(None).parse_buffer(bytearray(sample))
            wire.MAVLink(None).parse_buffer(bytearray(command))

    def ours_packs() -> None:
        for _ in range(times):
            traffic.make(samples, _STAMP, *_FORCE, *_RATE)
            traffic.make(torques, _STAMP, *_TORQUE, math.nan)

    def ours_reads() -> None:
        for _ in range(times):
            samples.read(sample, 0)
            torques.read(command, 0)

    def any_frame_is_read() -> None:
        for _ in range(times):
            for datagram in (sample, command):
                (frame,) = parse(datagram)
                if isinstance(frame, Frame):
                    _ = messages.parse_imu(frame) if datagram is sample else messages.parse_command(frame, 1)

    actions: dict[str, Action] = {
        "pymavlink packs": pymavlink_packs,
        "we pack": ours_packs,
        "pymavlink reads": pymavlink_reads,
        "we read any frame": any_frame_is_read,
        "we read the expected frame": ours_reads,
    }
    for name, seconds in in_turns(actions, 1 if bench.quick else 7).items():
        bench.row(name, "us a message", [value / times / 2 * 1e6 for value in seconds])
