"""Status: sensor health, readiness to arm, and landed state.

No battery is modelled, so its fields carry the values for unknown. SYS_STATUS reports zero voltage instead, like a
vehicle without battery monitor: dronekit reads the value for unknown as 65.5 V.

MAVLink, messages 1, 147, 193, 245. Programs for ArduPilot read readiness to arm from 193.
"""

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.services.service import Service, Stream, VehicleContext

_UNKNOWN16, _UNKNOWN, _NO_VOLTAGE = 2**16 - 1, -1, 0
# Ideal navigation replaces compass and GPS.
_SENSORS = (
    wire.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | wire.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | wire.MAV_SYS_STATUS_SENSOR_3D_MAG
    | wire.MAV_SYS_STATUS_SENSOR_GPS
    | wire.MAV_SYS_STATUS_SENSOR_ANGULAR_RATE_CONTROL
    | wire.MAV_SYS_STATUS_SENSOR_ATTITUDE_STABILIZATION
    | wire.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    | wire.MAV_SYS_STATUS_AHRS
    | wire.MAV_SYS_STATUS_PREARM_CHECK
)
# Navigation is ideal, so every estimate is good.
_ESTIMATED = (
    wire.EKF_ATTITUDE
    | wire.EKF_VELOCITY_HORIZ
    | wire.EKF_VELOCITY_VERT
    | wire.EKF_POS_HORIZ_REL
    | wire.EKF_POS_HORIZ_ABS
    | wire.EKF_POS_VERT_ABS
    | wire.EKF_PRED_POS_HORIZ_REL
    | wire.EKF_PRED_POS_HORIZ_ABS
)
# There is no fence, but clients that read this bit alone would otherwise report a breach.
_HEALTHY_SENSORS = _SENSORS | wire.MAV_SYS_STATUS_GEOFENCE


def make_service(context: VehicleContext) -> Service:
    """Return the service of the vehicle's status."""

    def extended() -> Message:
        landed_state = context.autopilot.landed_state.value
        return wire.MAVLink_extended_sys_state_message(wire.MAV_VTOL_STATE_UNDEFINED, landed_state)

    return Service(
        streams={
            wire.MAVLINK_MSG_ID_SYS_STATUS: Stream(_system_message, 1_000_000),
            wire.MAVLINK_MSG_ID_BATTERY_STATUS: Stream(_battery_message, 2_000_000),
            wire.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: Stream(extended, 1_000_000),
            wire.MAVLINK_MSG_ID_EKF_STATUS_REPORT: Stream(_estimator_message, 1_000_000),
        }
    )


def _system_message() -> Message:
    battery = (_NO_VOLTAGE, _UNKNOWN, _UNKNOWN)
    return wire.MAVLink_sys_status_message(_SENSORS, _SENSORS, _HEALTHY_SENSORS, 0, *battery, *[0] * 6)


def _estimator_message() -> Message:
    return wire.MAVLink_ekf_status_report_message(_ESTIMATED, *[0.0] * 5)


def _battery_message() -> Message:
    kind = wire.MAV_BATTERY_FUNCTION_ALL, wire.MAV_BATTERY_TYPE_UNKNOWN
    temperature, cells = 2**15 - 1, [_UNKNOWN16] * 10
    return wire.MAVLink_battery_status_message(0, *kind, temperature, cells, *[_UNKNOWN] * 4)
