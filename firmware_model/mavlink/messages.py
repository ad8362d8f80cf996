"""Convert samples and set-points to and from messages; no other module knows their wire fields, units and signs.

The wire uses the project's axes and units: N north-east-down, B forward-right-down, quaternions w, x, y, z from B to N.
One exception: SET_ATTITUDE_TARGET is stamped in whole milliseconds.

MAVLink, common message set, messages 0, 62, 82, 83, 105, 139, 140.
"""

import math
import struct
from collections.abc import Callable
from functools import cache

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.channel import Channel
from firmware_model.mavlink.frames import EncodedMessage, Frame, FrameTemplate, Message, RejectReason
from firmware_model.types import AttitudeTarget, Command, ImuSample, Quaternion, TorqueCommand, Vector

AUTOPILOT = 1
"""Component id of the autopilot."""
CONTROLLER = 191
"""Component id of an on-board controller (MAV_COMP_ID_ONBOARD_COMPUTER)."""
ABSENT = {wire.MAV_COMP_ID_GIMBAL: "gimbal", wire.MAV_COMP_ID_WINCH: "winch"}
"""Absent components that clients send commands to, by id; the autopilot rejects on their behalf."""

# Layouts of the per-sample messages; fields in wire order, largest first.
_IMU = wire.MAVLink_highres_imu_message.unpacker
_COARSE_IMU = {kind.id: kind.unpacker for kind in (wire.MAVLink_raw_imu_message, wire.MAVLink_scaled_imu_message)}
_TORQUE = wire.MAVLink_set_actuator_control_target_message.unpacker
_TARGET = wire.MAVLink_set_attitude_target_message.unpacker
_TILT = wire.MAVLink_nav_controller_output_message.unpacker
_MG = 9.80665e-3  # [m/s^2] unit of accelerations in RAW_IMU and SCALED_IMU
_GYRO = 0x38  # HIGHRES_IMU_UPDATED_FLAGS: bits of the fields that carry a measurement
_ACCELERATION_AND_GYRO = 0x7 | _GYRO
# HIGHRES_IMU of this vehicle: stamp, specific force and rates change; magnetic field, pressures, altitude and
# temperature are zero and not marked as measured.
_IMU_REST = struct.pack("<7fB", *[0.0] * 7, _ACCELERATION_AND_GYRO)
_IGNORE_ROLL_RATE, _IGNORE_PITCH_RATE, _IGNORE_YAW_RATE = 1, 2, 4  # ATTITUDE_TARGET_TYPEMASK
_THRUST_BODY_SET, _IGNORE_THROTTLE, _IGNORE_ATTITUDE = 32, 64, 128
_TYPES = {
    4: wire.MAV_TYPE_QUADROTOR,
    6: wire.MAV_TYPE_HEXAROTOR,
    8: wire.MAV_TYPE_OCTOROTOR,
    10: wire.MAV_TYPE_DECAROTOR,
    12: wire.MAV_TYPE_DODECAROTOR,
}
_UNIT_TOLERANCE = 1e-3  # [-] on a quaternion's length: far above float32 rounding; such a one is flown as it is
_MOST_LENGTH = 2.0  # [-] of a quaternion, or the inverse of its length: beyond, it is no scaled attitude but a mistake
_WRAP_MS = 2**32  # range of `time_boot_ms`


def imu_message(sample: ImuSample) -> EncodedMessage:
    """Return HIGHRES_IMU; magnetometer and barometer are marked as not measured."""
    return imu_template(1).encode(sample.time_us, *sample.specific_force_B, *sample.gyro_B)


def parse_imu(frame: Frame) -> ImuSample | RejectReason:
    """Return the sample in a HIGHRES_IMU, or a reason if it has no gyro measurement or a number that is not finite.

    RAW_IMU and SCALED_IMU are read as ArduPilot sends them: mrad/s and mg, stamped in us and ms.
    """
    if unpacker := _COARSE_IMU.get(frame.message_id):
        stamp, x, y, z, p, q, r, *_ = unpacker.unpack(frame.payload)
        time_us = stamp if frame.message_id == wire.MAVLINK_MSG_ID_RAW_IMU else 1000 * stamp
        return ImuSample(time_us, (1e-3 * p, 1e-3 * q, 1e-3 * r), (_MG * x, _MG * y, _MG * z))
    time_us, x, y, z, p, q, r, _, _, _, _, _, _, _, updated, _ = _IMU.unpack(frame.payload)
    if updated & _GYRO != _GYRO or not math.isfinite(x + y + z + p + q + r):
        return RejectReason.NOT_FINITE
    return ImuSample(time_us=time_us, gyro_B=(p, q, r), specific_force_B=(x, y, z))


@cache
def imu_template(system: int) -> FrameTemplate:
    """Return the template of the autopilot's samples: stamp [us], specific force [m/s^2], rates [rad/s]."""
    return FrameTemplate(wire.MAVLINK_MSG_ID_HIGHRES_IMU, system, AUTOPILOT, "<Q6f", _IMU_REST)


def tilt_message(tilt_deg: tuple[float, float]) -> EncodedMessage:
    """Return NAV_CONTROLLER_OUTPUT: roll and pitch [deg] that the position loop asks for; nothing else is told."""
    return EncodedMessage(wire.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT, _TILT.pack(*tilt_deg, *[0] * 6))


def sample_packer(channel: Channel, system: int) -> Callable[[ImuSample], bytes]:
    """Return the packer of samples for one peer; all of a flight, a stream and a request leave through it.

    The tilt that holds a place stands before its sample in the same datagram: neither comes without the other.
    """
    template = imu_template(system)

    def pack(sample: ImuSample) -> bytes:
        before = b"" if sample.tilt_deg is None else channel.pack(tilt_message(sample.tilt_deg))
        return before + channel.make(template, sample.time_us, *sample.specific_force_B, *sample.gyro_B)

    return pack


def torque_template(system: int) -> FrameTemplate:
    """Return the template of a controller's torque commands: stamp [us], roll, pitch, yaw, throttle or NaN."""
    rest = struct.pack("<4fBBB", 0.0, 0.0, 0.0, 0.0, 0, system, AUTOPILOT)
    return FrameTemplate(wire.MAVLINK_MSG_ID_SET_ACTUATOR_CONTROL_TARGET, system, CONTROLLER, "<Q4f", rest)


def rate_template(system: int) -> FrameTemplate:
    """Return the template of a controller's rate commands: stamp [ms], roll, pitch, yaw [rad/s], thrust."""
    rest = struct.pack("<BBB", system, AUTOPILOT, _IGNORE_ATTITUDE)
    return FrameTemplate(wire.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET, system, CONTROLLER, "<I16x4f", rest)


def command_message(command: Command, target_system: int) -> EncodedMessage:
    """Return the set-point message of a command.

    Raises
    ------
    ValueError
        If an attitude target has neither attitude nor rates.
    """
    if isinstance(command, TorqueCommand):
        payload = _TORQUE.pack(command.time_us, *_controls(command), 0, target_system, AUTOPILOT)
        return EncodedMessage(wire.MAVLINK_MSG_ID_SET_ACTUATOR_CONTROL_TARGET, payload)
    mask, q_NB, omega_B = _target_fields(command)
    fields = boot_ms(command.time_us), *q_NB, *omega_B, _thrust_field(command.thrust), target_system, AUTOPILOT, mask
    return EncodedMessage(wire.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET, _TARGET.pack(*fields))


def parse_command(frame: Frame, system: int) -> Command | RejectReason:
    """Return the command in a SET_ATTITUDE_TARGET or SET_ACTUATOR_CONTROL_TARGET to the autopilot of `system`.

    An attitude is tracked unless its mask bit is set, with the yaw rate as feed-forward; a quaternion of half to twice
    the unit length is normalised. Otherwise rates are tracked, if roll and pitch rates are both given (PX4's rule).
    Torques are clipped to -1..1 and thrust to 0..1. Beside torques, a throttle of NaN requests the on-board altitude
    hold.
    """
    if frame.message_id == wire.MAVLINK_MSG_ID_SET_ACTUATOR_CONTROL_TARGET:
        return _parse_torque_command(frame, system)
    time_ms, w, x, y, z, p, q, r, thrust, target_system, component, mask = _TARGET.unpack(frame.payload)
    if not is_addressed_to(system, target_system, component):
        return RejectReason.OTHER_TARGET
    if mask & (_IGNORE_THROTTLE | _THRUST_BODY_SET) or not math.isfinite(thrust):
        return RejectReason.NO_SETPOINT
    tracked = _parse_target(mask, (w, x, y, z), (p, q, 0.0 if mask & _IGNORE_YAW_RATE else r))
    if isinstance(tracked, RejectReason):
        return tracked
    q_NB, omega_B = tracked
    return AttitudeTarget(time_us=time_ms * 1000, q_NB=q_NB, omega_B=omega_B, thrust=_clip(thrust, 0.0))


def _parse_torque_command(frame: Frame, system: int) -> TorqueCommand | RejectReason:
    time_us, roll, pitch, yaw, throttle, _, _, _, _, group, target, component = _TORQUE.unpack(frame.payload)
    if not is_addressed_to(system, target, component):
        return RejectReason.OTHER_TARGET
    if group != 0:
        return RejectReason.NO_SETPOINT
    if not math.isfinite(roll + pitch + yaw):
        return RejectReason.NOT_FINITE
    torque_B = (_clip(roll, -1.0), _clip(pitch, -1.0), _clip(yaw, -1.0))
    return TorqueCommand(time_us, torque_B, None if math.isnan(throttle) else _clip(throttle, 0.0))


_Tracked = tuple[Quaternion | None, Vector | None]


def _parse_target(mask: int, q_NB: Quaternion, omega_B: Vector) -> _Tracked | RejectReason:
    """Return attitude and rates to track from the fields of a SET_ATTITUDE_TARGET."""
    if mask & _IGNORE_ATTITUDE:
        if mask & (_IGNORE_ROLL_RATE | _IGNORE_PITCH_RATE):
            return RejectReason.NO_SETPOINT
        return (None, omega_B) if math.isfinite(sum(omega_B)) else RejectReason.NOT_FINITE
    length = math.hypot(*q_NB)
    if not math.isfinite(length + omega_B[2]):
        return RejectReason.NOT_FINITE
    if not 1.0 / _MOST_LENGTH <= length <= _MOST_LENGTH:
        return RejectReason.BAD_QUATERNION
    if abs(length - 1.0) >= _UNIT_TOLERANCE:  # PX4 normalises each
        w, x, y, z = q_NB
        q_NB = w / length, x / length, y / length, z / length
    return q_NB, None if mask & _IGNORE_YAW_RATE else (0.0, 0.0, omega_B[2])


def is_addressed_to(system: int, target_system: int, target_component: int) -> bool:
    """Return whether a message is addressed to the autopilot of `system`; 0 addresses all."""
    return target_system in (0, system) and target_component in (0, AUTOPILOT)


def boot_ms(time_us: int) -> int:
    """Return a time as the field `time_boot_ms`, which wraps after 49 days."""
    return time_us // 1000 & 0xFFFF_FFFF


def stamp_difference(command: Command, time_us: int) -> int:
    """Return how much newer the command's stamp is than `time_us`, at the resolution of its message.

    The unit is ms for an attitude target and us for torques; 0 means that the command answers that sample. An attitude
    target's stamp wraps, so half its range lies ahead of any time, and half behind.
    """
    if isinstance(command, AttitudeTarget):
        return (command.time_us // 1000 - time_us // 1000 + _WRAP_MS // 2) % _WRAP_MS - _WRAP_MS // 2
    return command.time_us - time_us


def command_long_message(command: int, target_system: int, *parameters: float) -> Message:
    """Return a COMMAND_LONG to the autopilot of a system; parameters that are left out are 0."""
    numbers = (*map(float, parameters), *[0.0] * 7)[:7]
    return wire.MAVLink_command_long_message(target_system, AUTOPILOT, command, 0, *numbers)


def heartbeat_message(
    custom_mode: int, armed: bool, *, critical: bool, generic: bool = False, rotors: int = 4
) -> Message:
    """Return the HEARTBEAT of a vehicle with `rotors` and PX4, or a `generic` autopilot."""
    kind = _TYPES.get(rotors, wire.MAV_TYPE_GENERIC_MULTIROTOR)
    base_mode = wire.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (wire.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
    flying = wire.MAV_STATE_CRITICAL if critical else wire.MAV_STATE_ACTIVE
    state = flying if armed else wire.MAV_STATE_STANDBY
    autopilot = wire.MAV_AUTOPILOT_GENERIC if generic else wire.MAV_AUTOPILOT_PX4
    return wire.MAVLink_heartbeat_message(kind, autopilot, base_mode, custom_mode, state, 3)


def parse_parameter(message: Message, *, bytewise: bool = True) -> float:
    """Return the value in a PARAM_VALUE; integers are encoded `bytewise` in the float field, or cast to float."""
    if not bytewise or not is_whole_parameter(message):
        return float(message.param_value)
    return float(struct.unpack("<i", struct.pack("<f", message.param_value))[0])


def is_whole_parameter(message: Message) -> bool:
    """Return whether a PARAM_VALUE is of a type of whole numbers."""
    return bool(message.param_type != wire.MAV_PARAM_TYPE_REAL32)


def echo_message(command: Command) -> Message:
    """Return ATTITUDE_TARGET or ACTUATOR_CONTROL_TARGET: the set-point that the vehicle tracks."""
    if isinstance(command, TorqueCommand):
        return wire.MAVLink_actuator_control_target_message(command.time_us, 0, _controls(command))
    mask, q_NB, omega_B = _target_fields(command)
    thrust = _thrust_field(command.thrust)
    return wire.MAVLink_attitude_target_message(boot_ms(command.time_us), mask, q_NB, *omega_B, thrust)


def _controls(command: TorqueCommand) -> tuple[float, ...]:
    return (*command.torque_B, _thrust_field(command.throttle), 0.0, 0.0, 0.0, 0.0)


def _target_fields(target: AttitudeTarget) -> tuple[int, Quaternion, Vector]:
    if target.q_NB is not None:
        mask = _IGNORE_ROLL_RATE | _IGNORE_PITCH_RATE | (_IGNORE_YAW_RATE if target.omega_B is None else 0)
        return mask, target.q_NB, target.omega_B or (0.0, 0.0, 0.0)
    if target.omega_B is None:
        raise ValueError("an attitude target needs q_NB, omega_B or both, got neither")
    return _IGNORE_ATTITUDE, (0.0, 0.0, 0.0, 0.0), target.omega_B


def _thrust_field(thrust: float | None) -> float:
    return math.nan if thrust is None else thrust


def _clip(value: float, low: float) -> float:
    return low if value < low else 1.0 if value > 1.0 else value
