"""Write a flight as ULog, under the names of PX4's topics: for Flight Review, PlotJuggler and pyulog.

A topic is PX4's where it has the same meaning. Position and wind are the true ones; the gyro is measured. Attitude is
the true one too, but of a real autopilot its own estimate, as in its own log, beside the ground truth. Stamps are model
time. Torques are normalised by the vehicle's limits, as PX4's set-points are. What PX4 alone has is left out. PX4 has
no topic for the torque of a disturbance.

References
----------
PX4, *ULog File Format*, https://docs.px4.io/main/en/dev_log/ulog_file_format.html
"""

import struct
from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from firmware_model.autopilot.modes import Mode
from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.config.whole_file import whole_file
from firmware_model.numerics.rotations import from_euler, rotate_rows
from firmware_model.recording.estimates import ESTIMATE
from firmware_model.recording.journal import record_blocks
from gustproof.flight.recording.derived import angle_blocks
from gustproof.types import Array, Records
from gustproof.version import __version__

_MAGIC = b"ULog\x01\x12\x35\x01" + bytes(8)  # and the start of the log [us]
_STAMPS = ("timestamp", "timestamp_sample")
_RATE = b"\x18int32_t IMU_GYRO_RATEMAX"  # of the loops [Hz]
_STATUS, _LANDED = 100, 101
"""Numbers of the topics that are written at changes of the mode."""
_NAV_STATES = {
    Mode.MANUAL: 0,
    Mode.ALTCTL: 1,
    Mode.POSCTL: 2,
    Mode.TAKEOFF: 17,
    Mode.HOLD: 4,
    Mode.RETURN: 5,
    Mode.LAND: 18,
    Mode.ACRO: 10,
    Mode.OFFBOARD: 14,
    Mode.STABILIZED: 15,
}
"""Numbers of PX4's `nav_state`."""
_CHANGES = {
    _STATUS: "vehicle_status:uint64_t timestamp;uint8_t arming_state;uint8_t nav_state;",
    _LANDED: "vehicle_land_detected:uint64_t timestamp;bool landed;",
}


class _Sampled(NamedTuple):
    """A topic with a message for each sample."""

    name: str
    fields: Mapping[str, int]
    """Names of its single-precision fields, and how many numbers each has."""
    values: Callable[[Records, Array], Array]
    """Numbers (n, ...) of records (n,) and their references (n, 3) [rad]."""
    stamps: tuple[str, ...] = _STAMPS

    @property
    def format(self) -> str:
        """Definition of the message."""
        stamps = "".join(f"uint64_t {name};" for name in self.stamps)
        return f"{self.name}:{stamps}" + "".join(
            f"float{f'[{count}]' if count > 1 else ''} {name};" for name, count in self.fields.items()
        )


_XYZ, _ONE = {"xyz": 3}, ("timestamp",)


_ESTIMATED = [
    _Sampled("vehicle_attitude", {"q": 4}, lambda r, _: r["q_NB"]),
    _Sampled("vehicle_attitude_setpoint", {"q_d": 4}, lambda r, _: r["setpoint_q_NB"], _ONE),
]
"""Topics of a real autopilot's own attitude, with a message for each that it told."""


def _list_topics(vehicle: Vehicle, *, has_rates: bool, is_told: bool) -> list[_Sampled]:
    limits = np.array(vehicle.torque_limit)
    position = {name: 1 for name in ("x", "y", "z", "vx", "vy", "vz")}
    true = [
        _Sampled("vehicle_attitude", {"q": 4}, lambda r, _: r["q_NB"]),
        _Sampled("vehicle_attitude_setpoint", {"q_d": 4}, lambda _, angles: _quaternions(angles), _ONE),
    ]
    return [
        *([true[0]._replace(name="vehicle_attitude_groundtruth")] if is_told else true),
        _Sampled("vehicle_angular_velocity", _XYZ, lambda r, _: r["gyro_B"]),
        _Sampled("vehicle_angular_velocity_groundtruth", _XYZ, lambda r, _: r["omega_B"]),
        _Sampled("vehicle_acceleration", _XYZ, lambda r, _: r["specific_force_B"]),
        _Sampled("vehicle_torque_setpoint", _XYZ, lambda r, _: r["torque_command_B"] / limits),
        _Sampled("vehicle_local_position", position, lambda r, _: np.hstack([r["position_N"], r["velocity_N"]])),
        _Sampled("wind", {"windspeed_north": 1, "windspeed_east": 1}, lambda r, _: _air(r)[:, :2]),
        *(
            [_Sampled("vehicle_rates_setpoint", dict.fromkeys(("roll", "pitch", "yaw"), 1), _rates, _ONE)]
            if has_rates
            else []
        ),
    ]


def _quaternions(angles: Array) -> Array:
    """Return the attitudes (n, 4) of Euler angles (n, 3) [rad], few of which differ."""
    rows, places = np.unique(angles, axis=0, return_inverse=True)
    return np.array([from_euler(*row) for row in rows.tolist()])[places.reshape(-1)]


def _rates(records: Records, _: Array) -> Array:
    return np.asarray(records["omega_command_B"])


def _air(records: Records) -> Array:
    """Return the velocity (n, 3) [m/s] N of the air at the vehicle."""
    return np.asarray(records["wind_N"] + rotate_rows(records["q_NB"], records["gust_B"]))


def write_ulog(
    path: Path,
    records: Records,
    vehicle: Vehicle,
    scenario: Scenario,
    about: Mapping[str, str] | None = None,
    estimates: Records | None = None,
) -> None:
    """Write journal `records` (n,) as a ULog; `about` are texts by name for its head.

    `estimates` (m,) are the attitudes that a real autopilot told, see `firmware_model.recording.estimates`.

    Raises
    ------
    OSError
        If the file can't be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from gustproof import fly_direct, load_law, load_scenario, load_vehicle, read_log, write_ulog
    >>> scenario, vehicle = load_scenario("gust-roll"), load_vehicle("paper")
    >>> with TemporaryDirectory() as folder:
    ...     write_ulog(Path(folder) / "a.ulg", fly_direct(scenario, load_law("flagship")), vehicle, scenario)
    ...     len(read_log(Path(folder) / "a.ulg").gyro.time)
    2500
    """
    has_rates = any(not np.isnan(block["omega_command_B"]).all() for block in record_blocks(records))
    told = np.empty(0, dtype=ESTIMATE) if estimates is None else estimates
    topics, own = _list_topics(vehicle, has_rates=has_rates, is_told=len(told) > 0), _ESTIMATED if len(told) else []
    with whole_file(path) as file:
        file.write(_head([*topics, *own], scenario, about or {}))
        for part in _data(records, topics, scenario):
            file.write(part)
        for block in record_blocks(told):
            file.write(_messages(block, own, len(topics), np.empty(0)).tobytes())


def _head(topics: list[_Sampled], scenario: Scenario, about: Mapping[str, str]) -> bytes:
    """Return the definitions of all topics, with texts about the flight."""
    infos = {"sys_name": "gustproof", "ver_sw": __version__, **about}
    formats = [*(topic.format for topic in topics), *_CHANGES.values()]
    changes = ((number, text.partition(":")[0]) for number, text in _CHANGES.items())
    names = [*enumerate(topic.name for topic in topics), *changes]
    parts = [
        *(_info(name, text) for name, text in infos.items()),
        _message("P", _RATE + struct.pack("<i", round(1.0 / scenario.dt))),
        *(_message("F", definition.encode()) for definition in formats),
        *(_message("A", struct.pack("<BH", 0, number) + name.encode()) for number, name in names),
    ]
    return _MAGIC + b"".join(parts)


def _messages(block: Records, topics: list[_Sampled], first: int, angles: Array) -> Array:
    """Return the messages of topics, numbered from `first` on, for each of some records (n,) with references (n, 3)."""
    rows = np.zeros(len(block), dtype=[(topic.name, _layout(topic)) for topic in topics])
    for number, topic in enumerate(topics, first):
        row = rows[topic.name]
        row["size"], row["kind"], row["number"] = row.dtype.itemsize - 3, ord("D"), number
        row["stamps"] = block["time_us"].astype(np.uint64)[:, np.newaxis]
        row["values"] = topic.values(block, angles)
    return rows


def _data(records: Records, topics: list[_Sampled], scenario: Scenario) -> Iterator[bytes]:
    """Yield the samples of all topics in order of time, with the mode before each change of it."""
    before = None
    for block, angles in zip(record_blocks(records), angle_blocks(records, scenario), strict=True):
        stamps = block["time_us"].astype(np.uint64)
        rows = _messages(block, topics, 0, np.radians(angles["reference"]))
        modes = block["mode"].astype(np.int64)
        changes = np.flatnonzero(np.diff(modes, prepend=modes[0] + (before != modes[0]))).tolist()
        for begin, end in pairwise(sorted({0, *changes, len(block)})):
            if begin in changes:
                yield _status(int(stamps[begin]), Mode(int(modes[begin])))
            yield rows[begin:end].tobytes()
        before = modes[-1]


def _layout(topic: _Sampled) -> np.dtype[np.void]:
    head: list[Any] = [("size", "<u2"), ("kind", "u1"), ("number", "<u2"), ("stamps", "<u8", len(topic.stamps))]
    return np.dtype([*head, ("values", "<f4", sum(topic.fields.values()))])


def _status(time_us: int, mode: Mode) -> bytes:
    status = struct.pack("<HQBB", _STATUS, time_us, 2, _NAV_STATES[mode])  # 2 is armed
    return _message("D", status) + _message("D", struct.pack("<HQB", _LANDED, time_us, 0))


def _info(name: str, text: str) -> bytes:
    value = text.encode()[:200]
    key = f"char[{len(value)}] {name}".encode()
    return _message("I", bytes([len(key)]) + key + value)


def _message(kind: str, content: bytes) -> bytes:
    return struct.pack("<HB", len(content), ord(kind)) + content
