"""Outputs: the set-points or torques that act, and the rotors' thrusts as fractions and as pulse widths of real motors.

MAVLink, messages 36, 83, 140, 375.
"""

from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.modes import Mode
from firmware_model.mavlink import messages
from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.services.service import Service, Stream, VehicleContext
from firmware_model.types import AttitudeTarget, TorqueCommand

_OUTPUTS, _SERVOS = 32, 16  # capacity of the messages
_PULSE_US = (1000, 1000)  # [us] width at zero thrust, and its increase at full thrust


def make_service(context: VehicleContext) -> Service:
    """Return the service of set-points and rotor outputs."""
    loop = context.loop

    def tracks_own() -> bool:
        """Return whether the vehicle's own loops fly: what a controller sends that stands by has no effect."""
        return bool(context.autopilot.armed and loop.sample) and context.autopilot.mode is not Mode.OFFBOARD

    def echo(kind: type[AttitudeTarget | TorqueCommand]) -> Message | None:
        return messages.echo_message(context.setpoint) if isinstance(context.setpoint, kind) else None

    def targets() -> Message | None:
        return None if tracks_own() else echo(AttitudeTarget)

    def torques() -> Message | None:
        if not tracks_own():
            return echo(TorqueCommand)
        own = TorqueCommand(time_us=loop.observe().time_us, torque_B=loop.torque_command, throttle=None)
        return messages.echo_message(own)

    def servos() -> Message:
        time_us = loop.observe().time_us % 2**32
        pulses = [_PULSE_US[0] + round(_PULSE_US[1] * min(max(thrust, 0.0), 1.0)) for thrust in loop.rotors]
        return wire.MAVLink_servo_output_raw_message(time_us, 0, *pulses, *[0] * (_SERVOS - len(pulses)))

    def outputs() -> Message:
        time_us = loop.observe().time_us
        rotors = loop.rotors
        thrusts = (*rotors, *[0.0] * (_OUTPUTS - len(rotors)))
        return wire.MAVLink_actuator_output_status_message(time_us, 2 ** len(rotors) - 1, thrusts)

    return Service(
        streams={
            wire.MAVLINK_MSG_ID_ATTITUDE_TARGET: Stream(targets, 100_000),
            wire.MAVLINK_MSG_ID_ACTUATOR_CONTROL_TARGET: Stream(torques, 100_000),
            wire.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: Stream(servos, 100_000),
            wire.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS: Stream(outputs, 100_000),
        }
    )
