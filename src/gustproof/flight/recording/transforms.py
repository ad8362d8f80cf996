"""Frames of a bag as ROS's tf has them: /tf with the true pose, and /tf_static, which joins them to ENU and FLU.

Everything in a bag is north-east-down and forward-right-down. Viewers and ROS take the world to be east-north-up (REP
103): the static frames `map` and `base_link` turn it for them, under MAVROS' names.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gustproof.flight.recording.definitions import TF_MESSAGE, TYPES
from gustproof.flight.recording.topics import BASE_LINK_FRD, MAP_NED

TF_TOPIC, TF_STATIC_TOPIC = "/tf", "/tf_static"
TF_S = 0.02
"""[s] least time between two poses on /tf; readers interpolate."""
MAP, BASE_LINK = "map", "base_link"
_HALF = math.sqrt(0.5)
_STATIC = (
    (MAP, MAP_NED, (_HALF, _HALF, 0.0, 0.0)),  # half a turn about the line between north and east
    (BASE_LINK_FRD, BASE_LINK, (1.0, 0.0, 0.0, 0.0)),  # half a turn about forward
)
"""Parent, child, and rotation x, y, z, w from child to parent."""
_LITTLE_ENDIAN_CDR = 0x0100
_LAYOUT = np.dtype(
    [
        *((name, "<u4") for name in ("encapsulation", "count")),
        ("sec", "<i4"),
        ("nanosec", "<u4"),
        ("parent_length", "<u4"),
        ("parent", f"S{len(MAP_NED)}"),
        ("parent_end", "u1", 1 + -(len(MAP_NED) + 1) % 4),
        ("child_length", "<u4"),
        ("child", f"S{len(BASE_LINK_FRD)}"),
        ("child_end", "u1", 1 + -(24 + len(BASE_LINK_FRD) + 5) % 8),
        ("numbers", "<f8", 7),
    ]
)
"""One message with one transform in CDR; alignment counts from the end of the 4 bytes of encapsulation."""


def tf_rows(records: NDArray[np.void]) -> NDArray[np.int64]:
    """Return the places (k,) of the journal's `records` (n,) that stand on /tf: each `TF_S` or more after the last."""
    step_us = max(float(np.median(np.diff(records["time_us"]))), 1.0) if len(records) > 1 else 1.0
    return np.arange(0, len(records), max(1, math.ceil(1e6 * TF_S / step_us - 1e-6)))


def encode_tf(records: NDArray[np.void]) -> NDArray[np.void]:
    """Return messages (n,) of /tf, the true pose of the body in north, east, down, of the journal's `records` (n,)."""
    messages = np.zeros(len(records), dtype=_LAYOUT)
    messages["encapsulation"], messages["count"] = _LITTLE_ENDIAN_CDR, 1
    time_us = records["time_us"].astype(np.int64)
    messages["sec"], messages["nanosec"] = time_us // 1_000_000, time_us % 1_000_000 * 1000
    for name, text in (("parent", MAP_NED), ("child", BASE_LINK_FRD)):
        messages[f"{name}_length"], messages[name] = len(text) + 1, text.encode()
    messages["numbers"][:, :3] = records["position_N"]
    messages["numbers"][:, [6, 3, 4, 5]] = records["q_NB"]  # ROS has the scalar last
    return messages


def static_message(time_us: int) -> bytes:
    """Return the message of /tf_static: `map` and `base_link`, east-north-up and forward-left-up."""
    make = {name.rpartition("/")[2]: kind for name, kind in TYPES.types.items()}
    stamp = make["Time"](sec=time_us // 1_000_000, nanosec=time_us % 1_000_000 * 1000)

    def transform(parent: str, child: str, rotation: tuple[float, ...]) -> Any:
        turned = make["Transform"](make["Vector3"](0.0, 0.0, 0.0), make["Quaternion"](*rotation))
        return make["TransformStamped"](make["Header"](stamp, parent), child, turned)

    return bytes(TYPES.serialize_cdr(make["TFMessage"]([transform(*each) for each in _STATIC]), TF_MESSAGE))
