"""Hold the paper's vehicle level: gustproof fly calm --controller "exec: python client.py"."""

import math
import os
import time

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil

STIFFNESS, DAMPING = (2.2, 1.8, 0.9), (1.2, 1.0, 0.5)  # [N m/rad], [N m s/rad] about roll, pitch and yaw
LIMITS = ("GP_TRQ_MAX_R", "GP_TRQ_MAX_P", "GP_TRQ_MAX_Y")  # parameters that publish the torque [N m] of 1.0
link = mavutil.mavlink_connection(f"udpout:{os.environ['GUSTPROOF_ADDRESS']}", source_system=1, source_component=191)
limits: dict[str, float] = {}
angle, stamp_us, beat_s = [0.0] * 3, 0, -math.inf
while True:
    if time.monotonic() > beat_s + 1.0:
        beat_s = time.monotonic()
        link.mav.heartbeat_send(18, 8, 0, 0, 4)
    message = link.recv_match(blocking=True, timeout=0.5)
    kind = "" if message is None else message.get_type()
    if kind == "PARAM_VALUE":
        limits[message.param_id] = message.param_value
    if kind == "HEARTBEAT" and stamp_us > 0 and not message.base_mode & 128:
        break  # disarmed: the flight is over
    if kind != "HIGHRES_IMU":
        continue
    for name in LIMITS if len(limits) < 3 else ():
        link.mav.param_request_read_send(1, 1, name.encode(), -1)
    step_s, stamp_us = 1e-6 * (message.time_usec - stamp_us), message.time_usec
    rates = message.xgyro, message.ygyro, message.zgyro
    angle = [a + step_s * rate for a, rate in zip(angle, rates, strict=True)]  # a sample that is sent again adds none
    torque = [-k * a - d * rate for k, a, d, rate in zip(STIFFNESS, angle, DAMPING, rates, strict=True)]
    if len(limits) == 3:
        command = [max(-1.0, min(1.0, t / limits[name])) for t, name in zip(torque, LIMITS, strict=True)]
        link.mav.set_actuator_control_target_send(stamp_us, 0, 1, 1, [*command, math.nan, 0, 0, 0, 0])
    if stamp_us == 0:  # not begun: arm, then OFFBOARD, PX4's main mode 6
        link.mav.command_long_send(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
        link.mav.command_long_send(1, 1, 176, 0, 1, 6, 0, 0, 0, 0, 0)
