"""What the vehicle tells about itself; the messages of each sample are in tests/conformance/test_wire.py."""

import pytest

from firmware_model.mavlink import messages
from firmware_model.types import AttitudeTarget, TorqueCommand


def test_echo_tells_what_is_tracked():
    torque = TorqueCommand(time_us=4000, torque_B=(0.1, 0.2, 0.3), throttle=0.5)
    assert messages.echo_message(torque).controls == (0.1, 0.2, 0.3, 0.5, 0.0, 0.0, 0.0, 0.0)
    rates = AttitudeTarget(time_us=4000, q_NB=None, omega_B=(0.1, 0.2, 0.3), thrust=0.5)
    echo = messages.echo_message(rates)
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
