"""Bytes on the wire, derived by hand from the message definitions and read by pymavlink's own parser."""

import math
import struct

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import Frame, RejectReason, parse
from firmware_model.mavlink.messages import command_message, imu_message, parse_command, parse_imu
from firmware_model.types import AttitudeTarget, ImuSample, TorqueCommand

SAMPLE = ImuSample(time_us=4000, gyro_B=(0.5, -0.25, 2.0), specific_force_B=(0.0, 1.0, -9.75))


def crc(data: bytes) -> int:
    """CRC-16/MCRF4XX, bit by bit."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0x8408 if value & 1 else 0)
    return value


def frame(message_id: int, crc_extra: int, payload: bytes, *, sequence: int = 0, system: int = 1, component: int = 1):
    payload = payload.rstrip(b"\0") or b"\0"
    head = bytes([len(payload), 0, 0, sequence, system, component]) + message_id.to_bytes(3, "little")
    return b"\xfd" + head + payload + struct.pack("<H", crc(head + payload + bytes([crc_extra])))


def sender(component: int = 1) -> wire.MAVLink:
    return wire.MAVLink(None, 1, component)


def only(datagram: bytes) -> Frame:
    (found,) = parse(datagram)
    assert isinstance(found, Frame)
    return found


def test_imu_sample_has_the_bytes_of_highres_imu():
    payload = bytes.fromhex(
        "a00f000000000000"  # time_usec 4000
        "00000000 0000803f 00001cc1"  # xacc 0, yacc 1, zacc -9.75
        "0000003f 000080be 00000040"  # xgyro .5, ygyro -.25, zgyro 2
        "00000000 00000000 00000000 00000000 00000000 00000000 00000000"
        "3f00"  # fields_updated: acceleration 0x7, gyro 0x38
        "00"
    )
    assert imu_message(SAMPLE).pack(sender()) == frame(105, 93, payload)


def test_imu_sample_is_read_from_the_bytes():
    assert parse_imu(only(imu_message(SAMPLE).pack(sender()))) == SAMPLE


def test_level_rest_reads_minus_g_on_the_z_axis_in_pymavlink():
    rest = ImuSample(time_us=0, gyro_B=(0.0, 0.0, 0.0), specific_force_B=(0.0, 0.0, -9.806650161743164))
    (message,) = sender().parse_buffer(imu_message(rest).pack(sender()))
    assert message.get_type() == "HIGHRES_IMU"
    assert message.zacc == pytest.approx(-9.80665, abs=1e-6)  # one float32 step is 1e-6


@pytest.mark.parametrize("field", ["xgyro", "zacc"])
def test_imu_that_is_not_finite_is_dropped(field):
    (message,) = sender().parse_buffer(imu_message(SAMPLE).pack(sender()))
    setattr(message, field, math.nan)
    assert parse_imu(only(message.pack(sender()))) is RejectReason.NOT_FINITE


def test_imu_without_gyro_bits_is_no_sample():
    (message,) = sender().parse_buffer(imu_message(SAMPLE).pack(sender()))
    message.fields_updated = 0x7
    assert parse_imu(only(message.pack(sender()))) is RejectReason.NOT_FINITE


def test_torque_command_has_the_bytes_of_group_0():
    torque = TorqueCommand(time_us=8000, torque_B=(0.5, -1.0, 0.25), throttle=0.75)
    payload = bytes.fromhex(
        "401f000000000000"  # time_usec 8000
        "0000003f 000080bf 0000803e 0000403f"  # roll .5, pitch -1, yaw .25, throttle .75
        "00000000 00000000 00000000 00000000"
        "00 03 01"  # group 0, system 3, component 1
    )
    datagram = command_message(torque, 3).pack(sender(191))
    assert datagram == frame(139, 168, payload, component=191)
    assert parse_command(only(datagram), 3) == torque


def test_rates_travel_with_mask_128_and_an_empty_quaternion():
    rates = AttitudeTarget(time_us=12000, q_NB=None, omega_B=(0.5, -0.25, 2.0), thrust=0.5)
    payload = bytes.fromhex(
        "0c000000"  # 12 ms
        "00000000 00000000 00000000 00000000"  # q is masked, as MAVSDK sends it
        "0000003f 000080be 00000040"  # rates
        "0000003f"  # thrust .5
        "01 01 80"  # system 1, component 1, ignore attitude
    )
    datagram = command_message(rates, 1).pack(sender(191))
    assert datagram == frame(82, 49, payload, component=191)
    assert parse_command(only(datagram), 1) == rates


def test_attitude_travels_scalar_first_with_the_rates_masked():
    quarter_roll = (0.7071067690849304, 0.7071067690849304, 0.0, 0.0)  # float32 of sqrt(.5)
    target = AttitudeTarget(time_us=4000, q_NB=quarter_roll, omega_B=None, thrust=0.5)
    datagram = command_message(target, 1).pack(sender(191))
    (message,) = sender().parse_buffer(datagram)
    assert (message.time_boot_ms, message.type_mask, message.thrust) == (4, 7, 0.5)
    assert tuple(message.q) == quarter_roll
    assert parse_command(only(datagram), 1) == target


def attitude_target(mask, q=(1.0, 0.0, 0.0, 0.0), rates=(1.0, 2.0, 3.0), thrust=0.5, system=1, component=1) -> Frame:
    message = wire.MAVLink_set_attitude_target_message(4, system, component, mask, q, *rates, thrust)
    return only(message.pack(sender(191)))


@pytest.mark.parametrize(
    ("mask", "q_NB", "omega_B"),
    [
        (0, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 3.0)),  # attitude; only the yaw rate is fed forward
        (7, (1.0, 0.0, 0.0, 0.0), None),
        (3, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 3.0)),
        (128, None, (1.0, 2.0, 3.0)),
        (128 | 4, None, (1.0, 2.0, 0.0)),
    ],
)
def test_type_mask_says_what_is_tracked(mask, q_NB, omega_B):
    found = parse_command(attitude_target(mask), 1)
    assert found == AttitudeTarget(time_us=4000, q_NB=q_NB, omega_B=omega_B, thrust=0.5)


@pytest.mark.parametrize(
    ("fields", "cause"),
    [
        ({"mask": 64}, RejectReason.NO_SETPOINT),  # no thrust is no set-point
        ({"mask": 32}, RejectReason.NO_SETPOINT),
        ({"mask": 128 | 1}, RejectReason.NO_SETPOINT),
        ({"mask": 128 | 2}, RejectReason.NO_SETPOINT),
        ({"mask": 7, "thrust": math.nan}, RejectReason.NO_SETPOINT),
        ({"mask": 7, "q": (0.0, 0.0, 0.0, 0.0)}, RejectReason.BAD_QUATERNION),
        ({"mask": 7, "q": (math.nan, 0.0, 0.0, 0.0)}, RejectReason.NOT_FINITE),
        ({"mask": 128, "rates": (math.inf, 0.0, 0.0)}, RejectReason.NOT_FINITE),
        ({"mask": 7, "system": 9}, RejectReason.OTHER_TARGET),
        ({"mask": 7, "component": 2}, RejectReason.OTHER_TARGET),
    ],
)
def test_attitude_target_that_cannot_be_flown_is_dropped_with_its_cause(fields, cause):
    assert parse_command(attitude_target(**fields), 1) is cause


def test_masked_numbers_may_be_nan():
    found = parse_command(attitude_target(7, rates=(math.nan, math.nan, math.nan)), 1)
    assert found == AttitudeTarget(time_us=4000, q_NB=(1.0, 0.0, 0.0, 0.0), omega_B=None, thrust=0.5)


@pytest.mark.parametrize(
    ("controls", "group", "expected"),
    [
        ((3.0, -3.0, 0.5, 2.0), 0, TorqueCommand(time_us=4, torque_B=(1.0, -1.0, 0.5), throttle=1.0)),
        ((0.0, 0.0, math.nan, 0.5), 0, RejectReason.NOT_FINITE),
        ((0.0, 0.0, 0.0, 0.5), 1, RejectReason.NO_SETPOINT),
    ],
)
def test_torques_are_clipped_and_only_group_0_is_flown(controls, group, expected):
    message = wire.MAVLink_set_actuator_control_target_message(4, group, 1, 1, (*controls, 0.0, 0.0, 0.0, 0.0))
    assert parse_command(only(message.pack(sender(191))), 1) == expected
