"""The vehicle's MAVLink parameters, in one table: name, unit, default, range; integers travel bytewise, as PX4 does.

`GP_TRQ_MAX_*` publish what 1.0 of a torque command means. A parameter is a float32, so the published limit is too:
controller and vehicle both use that number, and no bit is lost between them.
"""

import math
import struct
from dataclasses import dataclass
from enum import Enum

import numpy as np

from firmware_model.scenario import Scenario
from firmware_model.signals import Vector
from firmware_model.vehicle import Vehicle

TORQUE_LIMIT_NAMES = ("GP_TRQ_MAX_R", "GP_TRQ_MAX_P", "GP_TRQ_MAX_Y")
"""Largest torque about roll, pitch and yaw."""
RATE_NAME = "IMU_INTEG_RATE"
"""Samples and commands per second."""
STREAM_TIMEOUT_NAME = "COM_OF_LOSS_T"
"""Time without set-points after which the fail-safe begins."""


def published_limit(vehicle: Vehicle) -> Vector:
    """Return the torque limits as published, [N*m] B: float32 values."""
    roll, pitch, yaw = (float(np.float32(limit)) for limit in vehicle.torque_limit)
    return roll, pitch, yaw


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """One parameter; an integer if `default` is one."""

    name: str
    """At most 16 characters."""
    default: float | int
    """[`unit`] value at start."""
    unit: str
    """Unit as shown to people."""
    minimum: float = -math.inf
    """[`unit`] smallest value that may be set."""
    maximum: float = math.inf
    """[`unit`] largest value that may be set."""
    read_only: bool = True
    """Whether it describes the vehicle or scenario, and so can't be set."""


class Refusal(Enum):
    """Why a parameter keeps its value."""

    READ_ONLY = "read-only"
    """It describes the vehicle or the scenario."""
    OUT_OF_RANGE = "out of range"
    """The value is outside the range, or not a number."""


class Parameters:
    """Values by name, in a fixed order."""

    def __init__(self, vehicle: Vehicle, scenario: Scenario) -> None:
        limits = zip(TORQUE_LIMIT_NAMES, published_limit(vehicle), strict=True)
        self.table = (
            *(Parameter(name=name, default=limit, unit="N*m") for name, limit in limits),
            Parameter(name=RATE_NAME, default=scenario.control_rate_hz, unit="Hz"),
            Parameter(name=STREAM_TIMEOUT_NAME, default=1.0, unit="s", minimum=0.1, maximum=60.0, read_only=False),
            Parameter(name="COM_OBL_RC_ACT", default=2, unit="2: Stabilized"),
            Parameter(name="SYS_AUTOSTART", default=4001, unit="PX4's generic quadcopter"),
            Parameter(name="SYS_HAS_MAG", default=0, unit="compasses"),
        )
        self._values = {parameter.name: parameter.default for parameter in self.table}
        self._index = {parameter.name: index for index, parameter in enumerate(self.table)}

    def __getitem__(self, name: str) -> float | int:
        return self._values[name]

    def index(self, name: str) -> int | None:
        """Return the place of a parameter in the table, `None` if there is no such."""
        return self._index.get(name)

    def wire_value(self, name: str) -> tuple[float, bool]:
        """Return the number as it travels in a float field, and whether it stands for an integer."""
        value = self._values[name]
        if isinstance(value, int):
            return struct.unpack("<f", struct.pack("<i", value))[0], True
        return value, False

    def set_wire_value(self, name: str, value: float) -> Refusal | None:
        """Set a parameter from a float field; the old value stays if that is refused."""
        parameter = self.table[self._index[name]]
        if parameter.read_only:
            return Refusal.READ_ONLY
        if not parameter.minimum <= value <= parameter.maximum:  # false for NaN too
            return Refusal.OUT_OF_RANGE
        self._values[name] = value
        return None
