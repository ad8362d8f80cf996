"""A pymavlink user's program: `mavutil_client.py SESSION ADDRESS` prints its observations as one JSON object."""

import json
import os
import socket
import sys
from typing import Any

os.environ["MAVLINK20"] = "1"  # read by mavutil when it is imported
from pymavlink import mavutil
from pymavlink.dialects.v20 import all as wire

PATIENCE_S = 60.0
REQUEST_MESSAGE = wire.MAV_CMD_REQUEST_MESSAGE


class Link:
    """Connection that sends every request once."""

    def __init__(self, address: str) -> None:
        self.link = mavutil.mavlink_connection(address, source_system=255, source_component=190, dialect="all")
        if address.startswith("udpout"):
            self.beat()

    def beat(self) -> None:
        self.link.mav.heartbeat_send(wire.MAV_TYPE_GCS, wire.MAV_AUTOPILOT_INVALID, 0, 0, 0)

    def meet(self) -> Any:
        beat = self.link.wait_heartbeat(timeout=PATIENCE_S)
        assert beat is not None, "no heartbeat"
        self.beat()
        return beat

    def next(self, kind: str, condition: str | None = None) -> Any:
        message = self.link.recv_match(type=kind, condition=condition, blocking=True, timeout=PATIENCE_S)
        assert message is not None, f"no {kind} {condition or ''}"
        return message

    def command(self, command: int, *numbers: float) -> int:
        """Give a command once and return its result."""
        target = self.link.target_system, self.link.target_component
        self.link.mav.command_long_send(*target, command, 0, *numbers, *[0.0] * (7 - len(numbers)))
        result: int = self.next("COMMAND_ACK", f"COMMAND_ACK.command == {command}").result
        return result

    def parameters(self) -> dict[str, float]:
        self.link.param_fetch_start = 0.0  # otherwise mavutil sends nothing within 2 s of the last fetch
        self.link.param_fetch_all()
        first = self.next("PARAM_VALUE")
        found = {first.param_id: first.param_value}
        while len(found) < first.param_count:
            value = self.next("PARAM_VALUE")
            found[value.param_id] = value.param_value
        return found


def fly(link: Link) -> dict:
    """Arm, change the mode, and read; as in pymavlink's examples."""
    link.meet()
    parameters = link.parameters()
    link.link.param_set_send("COM_OF_LOSS_T", 3.0, wire.MAV_PARAM_TYPE_REAL32)
    changed = link.next("PARAM_VALUE", "PARAM_VALUE.param_id == 'COM_OF_LOSS_T'").param_value
    modes = sorted(link.link.mode_mapping())
    link.link.set_mode(*link.link.mode_mapping()["POSCTL"])
    link.next("HEARTBEAT", "HEARTBEAT.custom_mode == 3 << 16")
    mode = link.link.flightmode
    link.link.arducopter_arm()
    link.next("HEARTBEAT", "HEARTBEAT.base_mode & 128")
    armed = bool(link.link.motors_armed())
    imu = link.next("HIGHRES_IMU")
    link.link.arducopter_disarm()
    link.next("HEARTBEAT", "not HEARTBEAT.base_mode & 128")
    return {
        "parameters": parameters,
        "changed": changed,
        "modes": modes,
        "mode": mode,
        "armed": armed,
        "zacc": imu.zacc,
        "lost": link.link.mav_loss,
    }


def download(link: Link) -> dict:
    """Request missions, fences, rally points and logs."""
    link.meet()
    counts, mav = [], link.link.mav
    for kind in (wire.MAV_MISSION_TYPE_MISSION, wire.MAV_MISSION_TYPE_FENCE, wire.MAV_MISSION_TYPE_RALLY):
        mav.mission_request_list_send(link.link.target_system, link.link.target_component, kind)
        count = link.next("MISSION_COUNT")
        counts.append([count.mission_type, count.count])
    mav.mission_count_send(link.link.target_system, link.link.target_component, 3, wire.MAV_MISSION_TYPE_MISSION)
    upload = link.next("MISSION_ACK").type
    mav.log_request_list_send(link.link.target_system, link.link.target_component, 0, 0xFFFF)
    return {"counts": counts, "upload": upload, "logs": link.next("LOG_ENTRY").num_logs}


def connect_as_qgroundcontrol(link: Link) -> dict:
    """Send QGroundControl's requests once, in its order."""
    beat = link.meet()
    versions = link.command(REQUEST_MESSAGE, wire.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    metadata = [link.command(REQUEST_MESSAGE, message_id) for message_id in (397.0, 395.0)]
    modes, wanted = [], 1
    while len(modes) < wanted:
        target = link.link.target_system, link.link.target_component
        link.link.mav.command_long_send(*target, REQUEST_MESSAGE, 0, 435.0, len(modes) + 1.0, 0, 0, 0, 0, 0)
        mode = link.next("AVAILABLE_MODES")
        wanted = mode.number_modes
        modes.append([mode.mode_index, mode.mode_name, mode.custom_mode])
    parameters = link.parameters()
    counts = []
    for kind in (wire.MAV_MISSION_TYPE_MISSION, wire.MAV_MISSION_TYPE_FENCE, wire.MAV_MISSION_TYPE_RALLY):
        link.link.mav.mission_request_list_send(link.link.target_system, link.link.target_component, kind)
        counts.append(link.next("MISSION_COUNT").count)
    return {
        "autopilot": beat.autopilot,
        "version": versions,
        "metadata": metadata,
        "modes": modes,
        "parameters": len(parameters),
        "counts": counts,
        "lost": link.link.mav_loss,
    }


def listen(link: Link) -> dict:
    """Listen for ten seconds of the vehicle's time, send a user's requests meanwhile, and count losses."""
    link.link.port.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)  # for a busy machine
    link.meet()
    start_us = stamp_us = link.next("HIGHRES_IMU").time_usec
    beats = 0
    while stamp_us < start_us + 10_000_000:
        stamp_us = link.next("HIGHRES_IMU").time_usec
        if (stamp_us - start_us) // 1_000_000 > beats:
            beats += 1
            link.beat()
            if beats % 3 == 0:
                link.parameters()
    return {"received": link.link.mav_count, "lost": link.link.mav_loss, "seconds": (stamp_us - start_us) * 1e-6}


SESSIONS = {session.__name__: session for session in (fly, download, connect_as_qgroundcontrol, listen)}

if __name__ == "__main__":
    print(json.dumps(SESSIONS[sys.argv[1]](Link(sys.argv[2]))))
