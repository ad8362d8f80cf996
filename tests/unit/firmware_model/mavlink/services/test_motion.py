"""What the vehicle tells of its motion, against values worked out by hand."""

import math

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.services import motion
from firmware_model.types import ImuSample

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
    message = motion.attitude_message(SAMPLE, q_NB)
    assert (message.roll, message.pitch, message.yaw) == pytest.approx(euler, abs=1e-12)
    assert (message.rollspeed, message.pitchspeed, message.yawspeed) == SAMPLE.gyro_B
    assert message.time_boot_ms == 12


def test_attitude_quaternion_is_scalar_first():
    message = motion.attitude_quaternion_message(SAMPLE, (0.5, 0.1, 0.2, 0.3))
    assert (message.q1, message.q2, message.q3, message.q4) == (0.5, 0.1, 0.2, 0.3)


def test_truth_is_told_in_degrees_millimetres_and_milli_g():
    message = motion.truth_message(
        SAMPLE, (1.0, 0.0, 0.0, 0.0), (0.1, 0.2, 0.3), (111.19492664455873, 0.0, -10.0), (1.0, -2.0, 0.5), 3.5
    )
    assert message.lat == 473_987_420  # .001 deg north of 47.397742, 111.19 m on a sphere of 6371 km
    assert message.lon == 85_455_940
    assert message.alt == 498_000  # 10 m above 488 m
    assert (message.vx, message.vy, message.vz) == (100, -200, 50)
    assert (message.ind_airspeed, message.zacc) == (350, -1000)
    message.pack(wire.MAVLink(None, 1, 1))


def test_truth_beyond_the_fields_range_is_clipped_not_refused():
    message = motion.truth_message(SAMPLE, (1.0, 0.0, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3, (1e6, -1e6, 0.0), 1e6)
    assert (message.vx, message.vy) == (32767, -32768)
    message.pack(wire.MAVLink(None, 1, 1))


def test_an_estimate_of_the_wind_is_answered_with_its_error(craft, order, monkeypatch):
    """Air that moves 8 m/s to the east is a wind from 270 deg."""
    monkeypatch.setattr(motion, "air_velocity_N", lambda _: (0.0, 8.0, 0.3))
    service = motion.make_service(craft)
    assert order(service, wire.MAV_CMD_EXTERNAL_WIND_ESTIMATE, 8.0, 1.0, 270.0)[0] == wire.MAV_RESULT_ACCEPTED
    order(service, wire.MAV_CMD_EXTERNAL_WIND_ESTIMATE, 8.0, 1.0, 90.0)
    assert craft.texts == [
        "wind 8.0 m/s from 270 deg: off by 0.0 m/s",
        "wind 8.0 m/s from 90 deg: off by 16.0 m/s",
    ]


@pytest.mark.parametrize("params", [(-1.0, 0.0, 90.0), (1e30, 0.0, 90.0), (5.0, 0.0, None), (None, 0.0, 90.0)])
def test_a_wind_without_speed_or_bearing_is_denied(craft, order, params):
    result, text = order(motion.make_service(craft), wire.MAV_CMD_EXTERNAL_WIND_ESTIMATE, *params)
    assert (result, len(text) <= 50) == (wire.MAV_RESULT_DENIED, True)
    assert craft.texts == []
