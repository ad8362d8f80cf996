"""MAVLink parameters of the vehicle: one table for the list, the checks and the documentation.

Names are PX4's where PX4 has the same thing; ours begin with GP_. Integers travel bytewise as in PX4, or cast to float
as in other autopilots. `GP_TRQ_MAX_*` publish the torque of 1.0 in a torque command. A parameter is a float32, so is
the published limit. Controller and vehicle both use that number, and no bit is lost between them.
"""

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

from firmware_model.autopilot.gains import POSITION_GAINS, TunableGain, replace_gains, stabilizer_gains
from firmware_model.autopilot.modes import FailSafe, Settings
from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import GRAVITY, PositionLoop, Stabilizer, Vehicle
from firmware_model.types import AXES, Vector

TORQUE_LIMIT_NAMES = ("GP_TRQ_MAX_R", "GP_TRQ_MAX_P", "GP_TRQ_MAX_Y")
"""Names of the largest torques about roll, pitch and yaw."""
RATE_NAME = "IMU_INTEG_RATE"
"""Name of the rate of samples and commands."""
HOVER_NAME = "MPC_THR_HOVER"
"""Name of the hover thrust."""
GUST_SCALE_NAME = "GP_GUST_SCALE"
"""Name of the gust intensity."""
PAUSE_NAME = "GP_PAUSE"
"""Name of the switch that stops model time."""

_DEVICE = 1_310_988  # PX4's number for the first simulated sensor; 0 means uncalibrated to clients


def published_limit(vehicle: Vehicle) -> Vector:
    """Return the torque limits as published, [N*m] B: float32 values."""
    roll, pitch, yaw = (float(np.float32(limit)) for limit in vehicle.torque_limit)
    return roll, pitch, yaw


def published_hover(vehicle: Vehicle) -> float:
    """Return the hover thrust as published, [-] of the largest: a float32 value."""
    return float(np.float32(vehicle.mass * GRAVITY / vehicle.rotors.total_thrust))


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter, an integer if `default` is one."""

    name: str
    """Name of at most 16 characters."""
    default: float | int
    """[`unit`] initial value."""
    meaning: str
    """One line of documentation."""
    unit: str = ""
    """Displayed unit; empty for a pure number."""
    minimum: float = -math.inf
    """[`unit`] smallest allowed value."""
    maximum: float = math.inf
    """[`unit`] largest allowed value."""
    choices: tuple[int, ...] = ()
    """[`unit`] allowed values, if they are few; empty for a range."""
    read_only: bool = False
    """True if it describes the vehicle or scenario and can't be set."""

    def is_allowed(self, value: float) -> bool:
        """Return whether a value is allowed; NaN is not."""
        return value in self.choices if self.choices else self.minimum <= value <= self.maximum

    @property
    def allowed_text(self) -> str:
        """Description of the allowed values."""
        if self.read_only:
            return "read-only"
        if self.choices:
            return ", ".join(map(str, self.choices))
        return f"{self.minimum:g} to {self.maximum:g}"


class ParameterRejectReason(Enum):
    """Reason for which a parameter keeps its value; each value is a text to display."""

    READ_ONLY = "read-only"
    """It describes the vehicle or the scenario."""
    OUT_OF_RANGE = "out of range"
    """The value is outside of the range, or NaN."""
    WRONG_TYPE = "has another type"
    """The value has another type than the parameter."""


def _round_float32(value: float | int) -> float | int:
    return value if isinstance(value, int) else float(f"{value:.7g}")  # digits of a float32


def _make_table(vehicle: Vehicle, scenario: Scenario) -> tuple[Parameter, ...]:
    limits = zip(TORQUE_LIMIT_NAMES, published_limit(vehicle), AXES, strict=True)
    loops = ((stabilizer_gains(vehicle), vehicle.stabilizer), (POSITION_GAINS, vehicle.position))
    usual = Settings()
    timeout_s, loss = usual.stream_timeout_us * 1e-6, "Time without set-points in OFFBOARD until the fail-safe"
    action = "Fail-safe when set-points stop: 2 level the vehicle, 4 land, 5 hold the position"
    torque, calibration = "Torque about {} of 1.0 in a torque set-point", "A simulated {}; 0 would mean uncalibrated"
    sensors = (("GYRO", "gyro"), ("ACC", "accelerometer"), ("MAG", "compass"))
    return (
        *(_fixed_parameter(name, limit, torque.format(axis), "N*m") for name, limit, axis in limits),
        _fixed_parameter(RATE_NAME, scenario.control_rate_hz, "Samples, and expected set-points, per second", "Hz"),
        Parameter("COM_OF_LOSS_T", timeout_s, loss, "s", 0.1, 60.0),
        Parameter("COM_OBL_RC_ACT", usual.fail_safe.value, action, choices=tuple(each.value for each in FailSafe)),
        Parameter("MIS_TAKEOFF_ALT", usual.takeoff_height, "Default take-off height above home", "m", 1.0, 500.0),
        Parameter("RTL_RETURN_ALT", usual.return_height, "Least height above home of the return", "m", 0.0, 500.0),
        Parameter("MPC_LAND_SPEED", usual.land_speed, "Descent rate near the ground", "m/s", 0.2, 1.5),
        _fixed_parameter(HOVER_NAME, published_hover(vehicle), "Hover thrust in a set-point"),
        Parameter(GUST_SCALE_NAME, 1.0, "Factor on all gusts of the scenario", minimum=0.0, maximum=3.0),
        Parameter(PAUSE_NAME, 0, "1 stops model time, 0 resumes the flight without a trace", choices=(0, 1)),
        *(
            Parameter(name, gain.display_value(loop), gain.meaning, gain.unit, gain.minimum, gain.maximum)
            for gains, loop in loops
            for name, gain in gains.items()
        ),
        _fixed_parameter("COM_RC_IN_MODE", 4, "4: no sticks"),
        _fixed_parameter("SYS_AUTOSTART", 4001, "PX4's generic quadcopter"),
        _fixed_parameter("SYS_HAS_MAG", 1, "1: the heading is known, from ideal navigation in place of a compass"),
        *(_fixed_parameter(f"CAL_{sensor}0_ID", _DEVICE, calibration.format(word)) for sensor, word in sensors),
    )


def _fixed_parameter(name: str, default: float | int, meaning: str, unit: str = "") -> Parameter:
    return Parameter(name, default, meaning, unit, read_only=True)


class Parameters:
    """Parameter values by name, in a fixed order; integers travel `bytewise`, or cast to float."""

    def __init__(self, vehicle: Vehicle, scenario: Scenario, *, bytewise: bool = True) -> None:
        self.table = _make_table(vehicle, scenario)
        self._vehicle, self._bytewise = vehicle, bytewise
        self._values = {parameter.name: parameter.default for parameter in self.table}
        self._index = {parameter.name: index for index, parameter in enumerate(self.table)}

    def __getitem__(self, name: str) -> float | int:
        return self._values[name]

    def index(self, name: str) -> int | None:
        """Return the index of a parameter in the table, `None` if there is no such parameter."""
        return self._index.get(name)

    def wire_value(self, name: str) -> tuple[float, bool]:
        """Return the value in a float field, and whether its type is integer on the wire."""
        value = self._values[name]
        if isinstance(value, int) and self._bytewise:
            return struct.unpack("<f", struct.pack("<i", value))[0], True
        return float(value), False

    def set_wire_value(self, name: str, value: float, *, integer: bool) -> ParameterRejectReason | None:
        """Set a parameter from a float field of a type; keep the old value if the new one is refused."""
        parameter = self.table[self._index[name]]
        is_integer = isinstance(parameter.default, int)
        if parameter.read_only:
            return ParameterRejectReason.READ_ONLY
        if integer is not (is_integer and self._bytewise):
            return ParameterRejectReason.WRONG_TYPE
        if integer:
            value = struct.unpack("<i", struct.pack("<f", value))[0]
        if not parameter.is_allowed(value):
            return ParameterRejectReason.OUT_OF_RANGE
        # The default, as float32, sets the default itself, with the bits that a float32 lacks.
        is_default = value == float(np.float32(parameter.default))
        self._values[name] = parameter.default if is_default else int(value) if is_integer else value
        return None

    def settings(self) -> Settings:
        """Return the autopilot's settings."""
        return Settings(
            stream_timeout_us=round(1e6 * self["COM_OF_LOSS_T"]),
            fail_safe=FailSafe(self["COM_OBL_RC_ACT"]),
            takeoff_height=self["MIS_TAKEOFF_ALT"],
            return_height=self["RTL_RETURN_ALT"],
            land_speed=self["MPC_LAND_SPEED"],
        )

    def stabilizer(self) -> Stabilizer:
        """Return the present gains of the attitude and rate loops."""
        gains = stabilizer_gains(self._vehicle)
        return replace_gains(self._vehicle.stabilizer, gains, self._changed_values(gains))

    def position_loop(self) -> PositionLoop:
        """Return the present gains and limits of the altitude and position loops."""
        return replace_gains(self._vehicle.position, POSITION_GAINS, self._changed_values(POSITION_GAINS))

    def describe(self) -> list[dict[str, str | float]]:
        """Return the documentation of each parameter."""
        return [
            {
                "name": parameter.name,
                "type": "INT32" if isinstance(parameter.default, int) else "REAL32",
                "default": _round_float32(parameter.default),
                "unit": parameter.unit,
                "allowed": parameter.allowed_text,
                "meaning": parameter.meaning,
            }
            for parameter in self.table
        ]

    def _changed_values(self, gains: Mapping[str, TunableGain]) -> dict[str, float]:
        """Return the gains that differ from their defaults."""
        return {name: self[name] for name in gains if self[name] != self.table[self._index[name]].default}
