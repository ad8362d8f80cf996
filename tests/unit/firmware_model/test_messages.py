"""What the vehicle tells about itself; the messages of each sample are in tests/conformance/test_wire.py."""

import math

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model import messages
from firmware_model.signals import AttitudeTarget, ImuSample, TorqueCommand

SAMPLE = ImuSample(time_us=12_000, gyro_B=(0.5, -0.25, 2.0), specific_force_B=(0.0, 0.0, -9.80665))
HALF = math.sqrt(0.5)


@pytest.mark.parametrize(
    ("q_NB", "euler"),
    [
        ((HALF, HALF, 0.0, 0.0), (math.pi / 2, 0.0, 0.0)),
        ((math.cos(0.5), 0.0, math.sin(0.5), 0.0), (0.0, 1.0, 0.0)),
        ((HALF, 0.0, 0.0, HALF), (0.0, 0.0, math.pi / 2)),
    ],
)
def test_attitude_tells_one_turn_about_each_axis(q_NB, euler):
    message = messages.attitude_message(SAMPLE, q_NB)
    assert (message.roll, message.pitch, message.yaw) == pytest.approx(euler, abs=1e-12)
    assert (message.rollspeed, message.pitchspeed, message.yawspeed) == SAMPLE.gyro_B
    assert message.time_boot_ms == 12


def test_attitude_quaternion_is_scalar_first():
    message = messages.attitude_quaternion_message(SAMPLE, (0.5, 0.1, 0.2, 0.3))
    assert (message.q1, message.q2, message.q3, message.q4) == (0.5, 0.1, 0.2, 0.3)


def test_truth_is_told_in_degrees_millimetres_and_milli_g():
    message = messages.truth_message(
        SAMPLE, (1.0, 0.0, 0.0, 0.0), (0.1, 0.2, 0.3), (111.19492664455873, 0.0, -10.0), (1.0, -2.0, 0.5)
    )
    assert message.lat == 473_987_420  # .001 deg north of 47.397742, 111.19 m on a sphere of 6371 km
    assert message.lon == 85_455_940
    assert message.alt == 498_000  # 10 m above 488 m
    assert (message.vx, message.vy, message.vz) == (100, -200, 50)
    assert message.zacc == -1000
    message.pack(wire.MAVLink(None, 1, 1))


def test_truth_beyond_the_fields_range_is_clipped_not_refused():
    message = messages.truth_message(SAMPLE, (1.0, 0.0, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3, (1e6, -1e6, 0.0))
    assert (message.vx, message.vy) == (32767, -32768)
    message.pack(wire.MAVLink(None, 1, 1))


def test_echo_tells_what_is_tracked():
    torque = TorqueCommand(time_us=4000, torque_B=(0.1, 0.2, 0.3), throttle=0.5)
    assert messages.command_echo(torque).controls == (0.1, 0.2, 0.3, 0.5, 0.0, 0.0, 0.0, 0.0)
    rates = AttitudeTarget(time_us=4000, q_NB=None, omega_B=(0.1, 0.2, 0.3), thrust=0.5)
    echo = messages.command_echo(rates)
    assert (echo.type_mask, echo.body_pitch_rate, echo.time_boot_ms) == (128, 0.2, 4)


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


def test_stamps_are_compared_at_the_resolution_of_the_wire():
    target = AttitudeTarget(time_us=2000, q_NB=None, omega_B=(0.0, 0.0, 0.0), thrust=0.5)
    assert messages.stamp_difference(target, 2500) == 0
    assert messages.stamp_difference(target, 3000) == -1
    torque = TorqueCommand(time_us=2501, torque_B=(0.0, 0.0, 0.0), throttle=0.5)
    assert messages.stamp_difference(torque, 2500) == 1
