"""What the vehicle tells about itself; the messages of each sample are in tests/conformance/test_wire.py."""

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink import messages
from firmware_model.mavlink.frames import EncodedMessage, RejectReason, parse
from firmware_model.types import AttitudeTarget, Command, ImuSample, TorqueCommand


def test_echo_tells_what_is_tracked():
    torque = TorqueCommand(time_us=4000, torque_B=(0.1, 0.2, 0.3), throttle=0.5)
    assert messages.echo_message(torque).controls == (0.1, 0.2, 0.3, 0.5, 0.0, 0.0, 0.0, 0.0)
    rates = AttitudeTarget(time_us=4000, q_NB=None, omega_B=(0.1, 0.2, 0.3), thrust=0.5)
    echo = messages.echo_message(rates)
    assert (echo.type_mask, echo.body_pitch_rate, echo.time_boot_ms) == (128, 0.2, 4)


def test_a_sample_on_the_wire_tells_nothing_that_is_not_measured():
    sample = ImuSample(4000, (0.5, -0.25, 2.0), (1.0, -2.0, -8.0))
    (frame,) = parse(messages.imu_message(sample).pack(wire.MAVLink(None, 1, 1)))
    told = frame.message()
    rest = [getattr(told, name) for name in told.fieldnames[7:]]
    assert (told.time_usec, told.fields_updated, told.xgyro, told.zacc) == (4000, 63, 0.5, -8.0)
    assert rest == [0.0] * 7 + [63, 0]


@pytest.mark.parametrize("kind", ["raw", "scaled"])
def test_coarse_samples_are_in_thousandths(kind):
    make = getattr(wire, f"MAVLink_{kind}_imu_message")
    packed = make(4, 100, -200, -1000, 300, -400, 500, 0, 0, 0).pack(wire.MAVLink(None, 1, 1))
    sample = messages.parse_imu(parse(packed)[0])
    assert sample.time_us == (4 if kind == "raw" else 4000)
    assert sample.gyro_B == pytest.approx((0.3, -0.4, 0.5))
    assert sample.specific_force_B == pytest.approx((0.980665, -1.96133, -9.80665))


def test_rates_that_a_target_does_not_tell_are_zero_and_ignored():
    echo = messages.echo_message(AttitudeTarget(time_us=0, q_NB=(1.0, 0.0, 0.0, 0.0), omega_B=None, thrust=0.5))
    assert (echo.body_roll_rate, echo.body_pitch_rate, echo.body_yaw_rate, echo.type_mask) == (0.0, 0.0, 0.0, 0b111)


def test_attitude_target_without_anything_to_track_is_a_mistake():
    with pytest.raises(ValueError, match="neither"):
        messages.command_message(AttitudeTarget(time_us=0, q_NB=None, omega_B=None, thrust=0.5), 1)


@pytest.mark.parametrize(
    ("armed", "critical", "base_mode", "status"),
    [(False, False, 1, 3), (True, False, 129, 4), (True, True, 129, 5)],
)
def test_heartbeat_tells_arming_and_state(armed, critical, base_mode, status):
    message = messages.heartbeat_message(6 << 16, armed, critical=critical)
    assert (message.type, message.autopilot, message.base_mode, message.system_status) == (2, 12, base_mode, status)


@pytest.mark.parametrize(("rotors", "kind"), [(4, 2), (5, 43), (6, 13), (8, 14), (10, 35), (11, 43), (12, 29)])
def test_heartbeat_tells_the_number_of_rotors(rotors, kind):
    assert messages.heartbeat_message(0, False, critical=False, rotors=rotors).type == kind


def test_stamps_are_compared_at_the_resolution_of_the_wire():
    target = AttitudeTarget(time_us=2000, q_NB=None, omega_B=(0.0, 0.0, 0.0), thrust=0.5)
    assert messages.stamp_difference(target, 2500) == 0
    assert messages.stamp_difference(target, 3000) == -1
    torque = TorqueCommand(time_us=2501, torque_B=(0.0, 0.0, 0.0), throttle=0.5)
    assert messages.stamp_difference(torque, 2500) == 1


def test_stamp_in_milliseconds_wraps_after_49_days():
    days_us = 50 * 86_400_000_000
    assert messages.boot_ms(days_us) == 50 * 86_400_000 - 2**32
    target = AttitudeTarget(time_us=messages.boot_ms(days_us) * 1000, q_NB=None, omega_B=(0.0, 0.0, 0.0), thrust=0.5)
    assert messages.stamp_difference(target, days_us) == 0
    assert messages.stamp_difference(target, days_us + 1000) == -1


@pytest.mark.parametrize(
    ("group", "target", "yaw", "read"),
    [
        (0, 1, 1.0, TorqueCommand(time_us=4000, torque_B=(0.25, -0.5, 1.0), throttle=None)),
        (1, 1, 1.0, RejectReason.NO_SETPOINT),
        (0, 2, 1.0, RejectReason.OTHER_TARGET),
        (0, 1, math.nan, RejectReason.NOT_FINITE),
    ],
)
def test_finite_torques_of_group_0_to_this_vehicle_are_flown(group, target, yaw, read):
    controls = (0.25, -0.5, yaw, math.nan, 0.0, 0.0, 0.0, 0.0)
    assert read_slowly(wire.MAVLink_set_actuator_control_target_message(4000, group, target, 1, controls)) == read


@pytest.mark.parametrize(
    ("target", "mask", "thrust", "why"),
    [
        (2, 0, 0.5, RejectReason.OTHER_TARGET),
        (1, wire.ATTITUDE_TARGET_TYPEMASK_THROTTLE_IGNORE, 0.5, RejectReason.NO_SETPOINT),
        (1, 0x20, 0.5, RejectReason.NO_SETPOINT),
        (1, 0, math.inf, RejectReason.NO_SETPOINT),
        (1, 0x80 | wire.ATTITUDE_TARGET_TYPEMASK_BODY_ROLL_RATE_IGNORE, 0.5, RejectReason.NO_SETPOINT),
        (1, 0x80 | wire.ATTITUDE_TARGET_TYPEMASK_BODY_PITCH_RATE_IGNORE, 0.5, RejectReason.NO_SETPOINT),
    ],
)
def test_attitude_target_without_thrust_or_something_to_track_is_refused(target, mask, thrust, why):
    level = [1.0, 0.0, 0.0, 0.0]
    assert (
        read_slowly(wire.MAVLink_set_attitude_target_message(4, target, 1, mask, level, 0.0, 0.0, 0.0, thrust)) == why
    )


@pytest.mark.parametrize(("given", "taken"), [(1.5, 1.0), (1.0, 1.0), (-0.5, -0.5), (-1.0, -1.0), (-1.5, -1.0)])
def test_torques_and_thrusts_beyond_their_range_are_taken_at_its_ends(given, taken):
    for axis in range(4):
        controls = np.roll((given, *[0.25] * 3), axis).tolist()
        read = read_slowly(wire.MAVLink_set_actuator_control_target_message(4000, 0, 1, 1, [*controls, *[0.0] * 4]))
        asked = [taken if each == given else 0.25 for each in controls]
        assert read == torques(*asked[:3], throttle=max(asked[3], 0.0))
    told = wire.MAVLink_set_attitude_target_message(4, 1, 1, 0x80, [1.0, 0.0, 0.0, 0.0], 2.0, 0.0, 0.0, given)
    assert read_slowly(told) == rates(2.0, 0.0, 0.0, thrust=max(taken, 0.0))


@pytest.mark.parametrize(("mask", "omega_B"), [(3, (0.0, 0.0, 0.75)), (0, (0.0, 0.0, 0.75)), (7, None)])
def test_beside_an_attitude_the_yaw_rate_alone_is_taken(mask, omega_B):
    told = wire.MAVLink_set_attitude_target_message(4, 1, 1, mask, [0.5, 0.5, -0.5, 0.5], 0.5, -0.25, 0.75, 0.5)
    assert read_slowly(told) == AttitudeTarget(4000, (0.5, 0.5, -0.5, 0.5), omega_B, 0.5)


def test_yaw_rate_that_is_not_told_is_zero_beside_told_rates():
    told = wire.MAVLink_set_attitude_target_message(4, 1, 1, 0x84, [1.0, 0.0, 0.0, 0.0], 0.5, -0.25, math.nan, 0.5)
    assert read_slowly(told) == rates(0.5, -0.25, 0.0)


def torques(*torque_B: float, throttle: float | None = None, time_us: int = 4000) -> TorqueCommand:
    return TorqueCommand(time_us=time_us, torque_B=torque_B, throttle=throttle)


def rates(*omega_B: float, thrust: float = 0.5, time_us: int = 4000) -> AttitudeTarget:
    return AttitudeTarget(time_us=time_us, q_NB=None, omega_B=omega_B, thrust=thrust)


def read_slowly(message) -> Command | RejectReason:
    (frame,) = parse(message.pack(wire.MAVLink(None, 1, messages.CONTROLLER)))
    return messages.parse_command(frame, 1)


@pytest.mark.parametrize("measured", [0x3F, 0x38, 0x07, 0x1F, 0x00])
@pytest.mark.parametrize("field", range(7))
def test_sample_needs_a_gyro_and_finite_numbers(measured, field):
    for broken in (math.nan, math.inf, 0.5):
        numbers = [0.5 + k for k in range(6)]
        if field:
            numbers[field - 1] = broken
        payload = wire.MAVLink_highres_imu_message.unpacker.pack(4000, *numbers, *[0.0] * 7, measured, 0)
        packed = EncodedMessage(wire.MAVLINK_MSG_ID_HIGHRES_IMU, payload).pack(wire.MAVLink(None, 1, 1))
        (frame,) = parse(packed)
        force, gyro = tuple(numbers[:3]), tuple(numbers[3:])
        usable = measured & 0x38 == 0x38 and math.isfinite(sum(numbers))
        assert messages.parse_imu(frame) == (ImuSample(4000, gyro, force) if usable else RejectReason.NOT_FINITE)


@pytest.mark.parametrize("length", [0.5, 0.9985, 0.9989, 0.9995, 1.0005, 1.0011, 1.0015, 2.0])
def test_attitude_of_another_length_is_that_of_unit_length(length):
    q_NB = (0.5 * length, -0.5 * length, 0.5 * length, 0.5 * length)
    message = wire.MAVLink_set_attitude_target_message(4, 1, 1, 7, q_NB, 0.0, 0.0, 0.0, 0.5)
    read = read_slowly(message).q_NB
    assert math.hypot(*read) == pytest.approx(1.0, abs=1e-9 if abs(length - 1.0) > 1e-3 else 1e-3)
    assert read == pytest.approx((0.5, -0.5, 0.5, 0.5), abs=1e-3)


def test_attitude_of_nearly_unit_length_keeps_its_bits():
    q_NB = (0.50025, -0.5, 0.5, 0.5)
    read = read_slowly(wire.MAVLink_set_attitude_target_message(4, 1, 1, 7, q_NB, 0.0, 0.0, 0.0, 0.5)).q_NB
    assert read == tuple(float(np.float32(each)) for each in q_NB)


@pytest.mark.parametrize("length", [0.0, 1e-42, 1e-20, 0.49, 2.01, 100.0, 1e30])
def test_attitude_far_from_unit_length_is_refused_by_that_name(length):
    message = wire.MAVLink_set_attitude_target_message(4, 1, 1, 7, (0.0, length, 0.0, 0.0), 0.0, 0.0, 0.0, 0.5)
    assert read_slowly(message) is RejectReason.BAD_QUATERNION


@pytest.mark.parametrize(
    ("stamp_ms", "time_us", "newer"),
    [
        (5, 4_000, 1),
        (4, 4_999, 0),
        (3, 4_000, -1),
        (2, (2**32 - 3) * 1000, 5),  # wrapped, after 49.7 days
        (2**32 - 3, 2_000, -5),
        (0, 2**32 * 1000, 0),
        (7, 2**32 * 1000, 7),
        (2**31 - 1, 0, 2**31 - 1),
        (2**31, 0, -(2**31)),
    ],
)
def test_stamps_of_attitude_targets_are_compared_across_their_wrap(stamp_ms, time_us, newer):
    assert messages.stamp_difference(rates(0.0, 0.0, 0.0, time_us=stamp_ms * 1000), time_us) == newer


def test_stamps_of_torques_do_not_wrap():
    assert messages.stamp_difference(torques(0.0, 0.0, 0.0, time_us=5), (2**32 - 3) * 1000) == 5 - (2**32 - 3) * 1000


def test_commands_leave_the_unused_controls_at_zero():
    controls = read_fields(messages.command_message(torques(0.25, -0.5, 1.0, throttle=0.75), 3)).controls
    assert controls == [0.25, -0.5, 1.0, 0.75, 0.0, 0.0, 0.0, 0.0]


def read_fields(message):
    (frame,) = parse(message.pack(wire.MAVLink(None, 1, messages.CONTROLLER)))
    return frame.message()
