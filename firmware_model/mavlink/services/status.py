"""Status: sensor health, readiness to arm, and landed state.

Without a battery its fields carry the values for unknown. SYS_STATUS reports zero voltage instead, like a vehicle
without battery monitor: dronekit reads the value for unknown as 65.5 V.

MAVLink, messages 1, 147, 193, 245. Programs for ArduPilot read readiness to arm from 193.
"""

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import Message
from firmware_model.mavlink.services.service import Service, Stream, VehicleContext
from firmware_model.types import BatteryReading

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

    def extended_state() -> Message:
        landed_state = context.autopilot.landed_state.value
        return wire.MAVLink_extended_sys_state_message(wire.MAV_VTOL_STATE_UNDEFINED, landed_state)

    return Service(
        streams={
            wire.MAVLINK_MSG_ID_SYS_STATUS: Stream(lambda: _system_message(context.loop.battery), 1_000_000),
            wire.MAVLINK_MSG_ID_BATTERY_STATUS: Stream(lambda: _battery_message(context.loop.battery), 2_000_000),
            wire.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: Stream(extended_state, 1_000_000),
            wire.MAVLINK_MSG_ID_EKF_STATUS_REPORT: Stream(_estimator_message, 1_000_000),
        }
    )


def _system_message(battery: BatteryReading | None) -> Message:
    measured, sensor = (_NO_VOLTAGE, _UNKNOWN, _UNKNOWN), 0
    if battery is not None:
        measured, sensor = (
            (_millivolts(battery.voltage), *_current_and_rest(battery)),
            wire.MAV_SYS_STATUS_SENSOR_BATTERY,
        )
    health = _SENSORS | sensor, _SENSORS | sensor, _HEALTHY_SENSORS | sensor
    return wire.MAVLink_sys_status_message(*health, 0, *measured, *[0] * 6)


def _estimator_message() -> Message:
    return wire.MAVLink_ekf_status_report_message(_ESTIMATED, *[0.0] * 5)


def _battery_message(battery: BatteryReading | None) -> Message:
    kind = wire.MAV_BATTERY_FUNCTION_ALL, wire.MAV_BATTERY_TYPE_UNKNOWN
    temperature, cells = 2**15 - 1, [_UNKNOWN16] * 10
    if battery is None:
        return wire.MAVLink_battery_status_message(0, *kind, temperature, cells, *[_UNKNOWN] * 4)
    cell = _millivolts(battery.voltage / battery.cells)
    cells = [cell if i < battery.cells else _UNKNOWN16 for i in range(10)]
    more = [cell if i < battery.cells else 0 for i in range(10, 14)]
    (current, rest), used = _current_and_rest(battery), round(1000.0 * battery.used_ah)
    return wire.MAVLink_battery_status_message(
        0, *kind, temperature, cells, current, used, _UNKNOWN, rest, voltages_ext=more
    )


def _millivolts(voltage: float) -> int:
    return min(round(1000.0 * voltage), _UNKNOWN16 - 1)


def _current_and_rest(battery: BatteryReading) -> tuple[int, int]:
    """Return current [cA], at most what the field holds, and charge left [%]."""
    return min(round(100.0 * battery.current), 2**15 - 1), round(100.0 * battery.remaining)
