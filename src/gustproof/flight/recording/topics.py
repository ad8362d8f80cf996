"""ROS messages of the journal's fields, and the bytes of those messages.

Axes are the journal's, north-east-down and forward-right-down. Frame names are those of MAVROS: `map_ned` and
`base_link_frd`. Every message here is a stamped header followed by float64 numbers. So the messages of a topic are the
rows of one array, with the message's layout in little-endian CDR as dtype.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.vehicle import MOST_ROTORS
from firmware_model.recording.journal import record_type
from gustproof.flight.recording.definitions import ANGLES, COMMAND_AGE, rotors_message

MAP_NED = "map_ned"
BASE_LINK_FRD = "base_link_frd"
_LITTLE_ENDIAN_CDR = 0x0100  # the encapsulation header 00 01 00 00 read as a little-endian integer


class Topic(NamedTuple):
    """One stamped topic and the source of its numbers."""

    name: str
    """Topic."""
    message: str
    """ROS 2 type."""
    frame_id: str
    """Frame of the numbers."""
    numbers: int
    """Count of float64 after the header."""
    fields: Mapping[str, tuple[int, ...]]
    """Journal fields, each with the offset of each component among the numbers."""
    constants: tuple[tuple[int, float], ...] = ()
    """Offset and value [of the message's field] of nonzero numbers that are not from the journal."""

    @property
    def layout(self) -> np.dtype[np.void]:
        """Layout of one message in CDR; alignment counts from the end of the 4 bytes of encapsulation."""
        text = len(self.frame_id) + 1
        padding = -(12 + text) % 8
        head = [("encapsulation", "<u4"), ("sec", "<i4"), ("nanosec", "<u4"), ("length", "<u4")]
        return np.dtype([*head, ("frame_id", f"S{text + padding}"), ("numbers", "<f8", self.numbers)])


_WRENCH, _TWIST, _VECTOR = (f"geometry_msgs/msg/{name}Stamped" for name in ("Wrench", "Twist", "Vector3"))
_LINEAR, _ANGULAR, _UP = (0, 1, 2), (3, 4, 5), (2,)
_IMU = {"gyro_B": (13, 14, 15), "specific_force_B": (25, 26, 27)}
_NO_ATTITUDE = ((4, -1.0),)  # by the message's convention a covariance of -1: none is measured
_POSE = {"position_N": _LINEAR, "q_NB": (6, 3, 4, 5)}  # ROS has the scalar last

ROTORS_TOPIC = "/actuator/rotors"
TOPICS = (
    Topic("/imu", "sensor_msgs/msg/Imu", BASE_LINK_FRD, 37, _IMU, _NO_ATTITUDE),
    Topic("/command/torque", _WRENCH, BASE_LINK_FRD, 6, {"torque_command_B": _ANGULAR, "thrust_z_command": _UP}),
    Topic("/command/rates", _TWIST, BASE_LINK_FRD, 6, {"omega_command_B": _ANGULAR}),
    Topic("/command/age", COMMAND_AGE, BASE_LINK_FRD, 1, {"command_age": (0,)}),
    Topic("/actuator/torque", _WRENCH, BASE_LINK_FRD, 6, {"torque_B": _ANGULAR, "thrust_z": _UP}),
    Topic(ROTORS_TOPIC, rotors_message(4), BASE_LINK_FRD, 4, {"rotors": (0, 1, 2, 3)}),
    Topic("/truth/pose", "geometry_msgs/msg/PoseStamped", MAP_NED, 7, _POSE),
    Topic("/truth/velocity", _VECTOR, MAP_NED, 3, {"velocity_N": _LINEAR}),
    Topic("/truth/rates", _VECTOR, BASE_LINK_FRD, 3, {"omega_B": _LINEAR}),
    Topic("/gust", _TWIST, BASE_LINK_FRD, 6, {"gust_B": _LINEAR, "gust_omega_B": _ANGULAR}),
    Topic("/wind", _VECTOR, MAP_NED, 3, {"wind_N": _LINEAR}),
    Topic("/moment", _WRENCH, BASE_LINK_FRD, 6, {"moment_B": _ANGULAR}),
)
"""All fields of the journal of a quadrotor but the mode, which is written when it changes."""


def list_topics(rotors: int) -> tuple[Topic, ...]:
    """Return `TOPICS` for a vehicle with `rotors`."""
    message, fields = rotors_message(rotors), {"rotors": tuple(range(rotors))}
    return tuple(
        topic._replace(message=message, numbers=rotors, fields=fields) if topic.name == ROTORS_TOPIC else topic
        for topic in TOPICS
    )


def rotors_in(message_size: int) -> int:
    """Return the number of rotors in a message of that size [bytes] on `ROTORS_TOPIC`; 4 if none has it."""
    rotors = 4 + (message_size - next(topic.layout.itemsize for topic in TOPICS if topic.name == ROTORS_TOPIC)) // 8
    return rotors if 4 <= rotors <= MOST_ROTORS else 4


_QUATERNION, _SCALAR_LAST = "geometry_msgs/msg/QuaternionStamped", (3, 0, 1, 2)
ESTIMATE_TOPICS = (
    Topic("/autopilot/attitude", _QUATERNION, MAP_NED, 4, {"q_NB": _SCALAR_LAST}),
    Topic("/autopilot/setpoint", _QUATERNION, MAP_NED, 4, {"setpoint_q_NB": _SCALAR_LAST}),
)
"""Attitude and set-point as a real autopilot reported them."""
TOLD_WIND_TOPIC = Topic("/autopilot/wind", _VECTOR, MAP_NED, 3, {"told_wind_N": _LINEAR})
"""Wind as a real autopilot estimates it, if it tells one."""


ANGLE_TOPICS = tuple(
    Topic(f"/attitude/{name}", ANGLES, MAP_NED, 3, {name: (0, 1, 2)}) for name in ("euler", "reference", "error")
)
"""Euler angles for viewers, derived from the journal's attitude and the scenario's references."""


def encode(topic: Topic, records: NDArray[np.void]) -> NDArray[np.void]:
    """Return the messages (n,) of `topic.layout` of the journal `records` (n,)."""
    messages = np.zeros(len(records), dtype=topic.layout)
    messages["encapsulation"] = _LITTLE_ENDIAN_CDR
    time_us = records["time_us"].astype(np.int64)
    messages["sec"], messages["nanosec"] = time_us // 1_000_000, time_us % 1_000_000 * 1000
    messages["length"] = len(topic.frame_id) + 1
    messages["frame_id"] = topic.frame_id.encode()
    for offset, value in topic.constants:
        messages["numbers"][:, offset] = value
    for field, offsets in topic.fields.items():
        messages["numbers"][:, offsets] = records[field]
    return messages


def decode(topic: Topic, messages: NDArray[np.void], records: NDArray[np.void]) -> None:
    """Write the fields of `topic` from its `messages` (n,) into the journal `records` (n,)."""
    for field, offsets in topic.fields.items():
        records[field] = messages["numbers"][:, offsets]


def times_us(messages: NDArray[np.void]) -> NDArray[np.float64]:
    """Return the stamps (n,) [us] of a topic's messages."""
    return messages["sec"] * 1e6 + messages["nanosec"] / 1000.0


def nan_records(n: int, rotors: int) -> NDArray[np.void]:
    """Return `n` records of a vehicle with `rotors`, of NaN: numbers that a bag does not hold are unknown."""
    record = record_type(rotors)
    return np.full(n * (record.itemsize // 8), np.nan).view(record)
