import math
from types import SimpleNamespace

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.services import make_services
from firmware_model.mavlink.services.service import Service, Stream, merge_services
from firmware_model.types import AttitudeTarget, BatteryReading, ImuSample

HALF = math.sqrt(0.5)
# The vehicle looks west, .001 degrees north and .002 degrees of the equator east of the origin, 20 m up.
VECTORS = {
    "omega_B": (0.125, -0.25, 0.5),
    "position_N": (111.19492664455873, 222.38985328911747, -20.0),
    "velocity_N": (3.0, -4.0, -1.0),
    "gust_B": (1.0, 2.0, 0.5),
    "wind_N": (5.0, -3.0, 0.25),
}
SAMPLE = ImuSample(time_us=2**32 + 12_000, gyro_B=(0.5, -0.25, 2.0), specific_force_B=(0.0, 9.80665, -19.6133))
TOLD = """
HEARTBEAT None type=13 autopilot=12 base_mode=1 custom_mode=458752 system_status=3 mavlink_version=3
SYS_STATUS 1000000 onboard_control_sensors_present=304122919 onboard_control_sensors_enabled=304122919 \
onboard_control_sensors_health=305171495 voltage_battery=14800 current_battery=1250 battery_remaining=75
SYSTEM_TIME 1000000 time_boot_ms=2500
GPS_RAW_INT 200000 time_usec=4294979296 fix_type=3 lat=473987420 lon=85485486 alt=508000 eph=65535 epv=65535 vel=500 \
cog=30687 satellites_visible=255
ATTITUDE 10000 time_boot_ms=4294979 roll=1.5708 rollspeed=0.5 pitchspeed=-0.25 yawspeed=2
ATTITUDE_QUATERNION 20000 time_boot_ms=4294979 q1=0.707107 q2=0.707107 rollspeed=0.5 pitchspeed=-0.25 yawspeed=2
LOCAL_POSITION_NED 33000 time_boot_ms=4294979 x=111.195 y=222.39 z=-20 vx=3 vy=-4 vz=-1
GLOBAL_POSITION_INT 100000 time_boot_ms=4294979 lat=473987420 lon=85485486 alt=508000 relative_alt=15000 vx=300 \
vy=-400 vz=-100 hdg=27000
SERVO_OUTPUT_RAW 100000 time_usec=12000 servo1_raw=1250 servo2_raw=1500 servo3_raw=1750 servo4_raw=2000 \
servo5_raw=1000 servo6_raw=2000
GPS_GLOBAL_ORIGIN None latitude=473977420 longitude=85455940 altitude=488000 time_usec=2500000
VFR_HUD 100000 airspeed=4.36606 groundspeed=5 heading=270 throttle=62 alt=508 climb=1
ATTITUDE_TARGET 100000 time_boot_ms=4 type_mask=3 q=[1.0] body_yaw_rate=0.25 thrust=0.5
HIGHRES_IMU 20000
TIMESYNC 100000 ts1=2500000000
HIL_STATE_QUATERNION 20000 time_usec=4294979296 attitude_quaternion=[0.71, 0.0, 0.0, -0.71] rollspeed=0.125 \
pitchspeed=-0.25 yawspeed=0.5 lat=473987420 lon=85485486 alt=508000 vx=300 vy=-400 vz=-100 ind_airspeed=437 \
true_airspeed=437 yacc=1000 zacc=-2000
ACTUATOR_CONTROL_TARGET 100000
BATTERY_STATUS 2000000 battery_function=1 temperature=32767 \
voltages=[3700, 3700, 3700, 3700, 65535, 65535, 65535, 65535, 65535, 65535] current_battery=1250 current_consumed=250 \
energy_consumed=-1 battery_remaining=75
AUTOPILOT_VERSION None capabilities=8286 flight_sw_version=17760256
EKF_STATUS_REPORT 1000000 flags=831
WIND_COV 100000 time_usec=4294979296 wind_x=7 wind_y=-4 wind_z=0.75 var_horiz=nan var_vert=nan wind_alt=508
HOME_POSITION 2000000 latitude=473977420 longitude=85455940 altitude=493000 z=-5 q=[1.0] \
approach_x=nan approach_y=nan approach_z=nan time_usec=2500000
EXTENDED_SYS_STATE 1000000 landed_state=1
ACTUATOR_OUTPUT_STATUS 100000 time_usec=4294979296 active=63 actuator=[0.25, 0.5, 0.75, 1.5, -0.5, 1.0]
CURRENT_MODE 2000000 custom_mode=458752 intended_custom_mode=458752
"""


def test_services_combine_their_tables():
    one, two = (
        Service(streams={1: Stream(lambda: None)}),
        Service(streams={2: Stream(lambda: None)}, on_request={3: list}),
    )
    both = merge_services([one, two])
    assert (set(both.streams), set(both.on_request)) == ({1, 2}, {3})


def test_a_number_in_two_services_is_a_mistake():
    with pytest.raises(ValueError, match="number 7"):
        merge_services([Service(requests={7: print}), Service(requests={7: print, 8: print})])


def test_every_stream_has_its_interval_and_every_field_its_value_and_unit(craft):
    craft.autopilot.home_N = (0.0, 0.0, -5.0)
    craft.stamp_us = 2_500_000
    craft.setpoint = AttitudeTarget(time_us=4000, q_NB=(1.0, 0.0, 0.0, 0.0), omega_B=(0.0, 0.0, 0.25), thrust=0.5)
    craft.loop = SimpleNamespace(
        observe=lambda: SAMPLE,
        sample=True,
        q_NB=(HALF, 0.0, 0.0, -HALF),
        estimate_q_NB=(HALF, HALF, 0.0, 0.0),
        true_vector=VECTORS.get,
        rotors=(0.25, 0.5, 0.75, 1.5, -0.5, 1.0),
        rotor_count=6,
        thrust=0.625,
        battery=BatteryReading(cells=4, voltage=14.8, current=12.5, used_ah=0.25, remaining=0.75),
    )
    streams = sorted(make_services(craft).streams.items())
    assert [_show(number, stream) for number, stream in streams] == TOLD.strip().splitlines()


def _show(number: int, stream: Stream) -> str:
    """Return name, interval [us] and all fields of a stream's message that are not zero."""
    message, kind = stream.message(), wire.mavlink_map[number]
    if hasattr(message, "pack"):
        message.pack(wire.MAVLink(None, 1, 1))  # every number and list fits its field
    fields = {name: getattr(message, name) for name in kind.fieldnames} if hasattr(message, "pack") else {}
    shown = [f"{name}={text}" for name, value in fields.items() if (text := _text(value)) not in ("0", "-0", "[]")]
    return " ".join([kind.msgname, str(stream.interval_us), *shown])


def _text(value: int | float | tuple[float, ...]) -> str:
    """Return a number at six digits, a list at two without its last zeros."""
    if isinstance(value, int | float):
        return str(value) if isinstance(value, int) else f"{round(value, 12):g}"
    return str(np.trim_zeros(np.round(value, 2), "b").tolist())
