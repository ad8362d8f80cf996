"""The vehicle's MAVLink parameters, in one table, from which the list, the checks and the reference are made.

Names are PX4's where PX4 has the same thing; ours begin with GP_. Integers travel bytewise, as PX4 does it, or cast to
float as other autopilots do. `GP_TRQ_MAX_*` publish what 1.0 of a torque command means. A parameter is a float32, so
the published limit is too: controller and vehicle both use that number, and no bit is lost between them.
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
from firmware_model.types import Vector

TORQUE_LIMIT_NAMES = ("GP_TRQ_MAX_R", "GP_TRQ_MAX_P", "GP_TRQ_MAX_Y")
"""Largest torque about roll, pitch and yaw."""
RATE_NAME = "IMU_INTEG_RATE"
"""Samples and commands per second."""
HOVER_NAME = "MPC_THR_HOVER"
"""Thrust that hovers."""
GUST_SCALE_NAME = "GP_GUST_SCALE"
"""Intensity of the gusts."""
PAUSE_NAME = "GP_PAUSE"
"""Whether model time stands still."""

_DEVICE = 1_310_988  # PX4's number for the first simulated sensor; clients take 0 for one that is not calibrated


def published_limit(vehicle: Vehicle) -> Vector:
    """Return the torque limits as published, [N*m] B: float32 values."""
    roll, pitch, yaw = (float(np.float32(limit)) for limit in vehicle.torque_limit)
    return roll, pitch, yaw


def published_hover(vehicle: Vehicle) -> float:
    """Return the thrust that hovers as published, [-] of the largest: a float32 value."""
    return float(np.float32(vehicle.mass * GRAVITY / (4.0 * vehicle.rotors.thrust_max)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """One parameter; an integer if `default` is one."""

    name: str
    """At most 16 characters."""
    default: float | int
    """[`unit`] value at start."""
    unit: str = ""
    """Unit as shown to people; empty for a pure number."""
    minimum: float = -math.inf
    """[`unit`] smallest value that may be set."""
    maximum: float = math.inf
    """[`unit`] largest value that may be set."""
    choices: tuple[int, ...] = ()
    """The only values that may be set, if there are few."""
    read_only: bool = False
    """Whether it describes the vehicle or scenario, and so can't be set."""
    meaning: str
    """One line for people."""

    def allows(self, value: float) -> bool:
        """Whether the value may be set; NaN never may."""
        return value in self.choices if self.choices else self.minimum <= value <= self.maximum

    @property
    def allowed(self) -> str:
        """What may be set, for people."""
        if self.read_only:
            return "read-only"
        if self.choices:
            return ", ".join(map(str, self.choices))
        return f"{self.minimum:g} to {self.maximum:g}"


class ParameterRejectReason(Enum):
    """Why a parameter keeps its value; the values are texts for people."""

    READ_ONLY = "read-only"
    """It describes the vehicle or the scenario."""
    OUT_OF_RANGE = "out of range"
    """The value is outside the range, or not a number."""
    WRONG_TYPE = "has another type"
    """The value came as another type than the parameter's."""


def _round_float32(value: float | int) -> float | int:
    return value if isinstance(value, int) else float(f"{value:.7g}")  # what a float32 tells


def _make_table(vehicle: Vehicle, scenario: Scenario) -> tuple[Parameter, ...]:
    limits = zip(TORQUE_LIMIT_NAMES, published_limit(vehicle), ("roll", "pitch", "yaw"), strict=True)
    usual = Settings()
    return (
        *(
            Parameter(name=name, default=limit, unit="N*m", read_only=True,
                      meaning=f"Torque about {axis} that 1.0 of a torque set-point asks for")
            for name, limit, axis in limits
        ),
        Parameter(name=RATE_NAME, default=scenario.control_rate_hz, unit="Hz", read_only=True,
                  meaning="Samples, and set-points wanted, per second"),
        Parameter(name="COM_OF_LOSS_T", default=usual.stream_timeout_us * 1e-6, unit="s", minimum=0.1, maximum=60.0,
                  meaning="Time without set-points in OFFBOARD until the fail-safe"),
        Parameter(name="COM_OBL_RC_ACT", default=usual.fail_safe.value,
                  choices=tuple(action.value for action in FailSafe),
                  meaning="Fail-safe when set-points stop: 2 level the vehicle, 4 land, 5 hold the position"),
        Parameter(name="MIS_TAKEOFF_ALT", default=usual.takeoff_height, unit="m", minimum=1.0, maximum=500.0,
                  meaning="Height above home of a take-off that says no other"),
        Parameter(name="RTL_RETURN_ALT", default=usual.return_height, unit="m", minimum=0.0, maximum=500.0,
                  meaning="Least height above home on the way home"),
        Parameter(name="MPC_LAND_SPEED", default=usual.land_speed, unit="m/s", minimum=0.2, maximum=1.5,
                  meaning="Descent near the ground"),
        Parameter(name=HOVER_NAME, read_only=True, default=published_hover(vehicle),
                  meaning="Thrust of a set-point that hovers"),
        Parameter(name=GUST_SCALE_NAME, default=1.0, minimum=0.0, maximum=3.0,
                  meaning="All gusts, as a multiple of what the scenario says"),
        Parameter(name=PAUSE_NAME, default=0, choices=(0, 1),
                  meaning="1: model time stands still, and a flight goes on at 0 as if nothing had been"),
        *(
            Parameter(name=name, default=gain.told(loop), unit=gain.unit, minimum=gain.minimum, maximum=gain.maximum,
                      meaning=gain.meaning)
            for gains, loop in ((stabilizer_gains(vehicle), vehicle.stabilizer), (POSITION_GAINS, vehicle.position))
            for name, gain in gains.items()
        ),
        Parameter(name="COM_RC_IN_MODE", default=4, read_only=True, meaning="4: no sticks"),
        Parameter(name="SYS_AUTOSTART", default=4001, read_only=True, meaning="PX4's generic quadcopter"),
        Parameter(name="SYS_HAS_MAG", default=1, read_only=True,
                  meaning="1: the heading is known; ideal navigation stands for a compass"),
        *(
            Parameter(name=f"CAL_{sensor}0_ID", default=_DEVICE, read_only=True,
                      meaning=f"A simulated {word}; not 0, as it is calibrated")
            for sensor, word in (("GYRO", "gyro"), ("ACC", "accelerometer"), ("MAG", "compass"))
        ),
    )  # fmt: skip


class Parameters:
    """Values by name, in a fixed order; `bytewise` says how integers travel."""

    def __init__(self, vehicle: Vehicle, scenario: Scenario, *, bytewise: bool = True) -> None:
        self.table = _make_table(vehicle, scenario)
        self._vehicle, self._bytewise = vehicle, bytewise
        self._values = {parameter.name: parameter.default for parameter in self.table}
        self._index = {parameter.name: index for index, parameter in enumerate(self.table)}

    def __getitem__(self, name: str) -> float | int:
        return self._values[name]

    def index(self, name: str) -> int | None:
        """Return the place of a parameter in the table, `None` if there is no such."""
        return self._index.get(name)

    def wire_value(self, name: str) -> tuple[float, bool]:
        """Return the number as it travels in a float field, and whether it is to be told as an integer."""
        value = self._values[name]
        if isinstance(value, int) and self._bytewise:
            return struct.unpack("<f", struct.pack("<i", value))[0], True
        return float(value), False

    def set_wire_value(self, name: str, value: float, *, integer: bool) -> ParameterRejectReason | None:
        """Set a parameter from a float field told as an integer or not; the old value stays if that is refused."""
        parameter = self.table[self._index[name]]
        whole = isinstance(parameter.default, int)
        if parameter.read_only:
            return ParameterRejectReason.READ_ONLY
        if integer is not (whole and self._bytewise):
            return ParameterRejectReason.WRONG_TYPE
        if integer:
            value = struct.unpack("<i", struct.pack("<f", value))[0]
        if not parameter.allows(value):
            return ParameterRejectReason.OUT_OF_RANGE
        # What is set to the start value as it was told is that value again, with the bits that a float32 has not.
        start = value == float(np.float32(parameter.default))
        self._values[name] = parameter.default if start else int(value) if whole else value
        return None

    def settings(self) -> Settings:
        """Return what the autopilot is to go by."""
        return Settings(
            stream_timeout_us=round(1e6 * self["COM_OF_LOSS_T"]),
            fail_safe=FailSafe(self["COM_OBL_RC_ACT"]),
            takeoff_height=self["MIS_TAKEOFF_ALT"],
            return_height=self["RTL_RETURN_ALT"],
            land_speed=self["MPC_LAND_SPEED"],
        )

    def stabilizer(self) -> Stabilizer:
        """Return the gains of the attitude and rate loops as they are set."""
        gains = stabilizer_gains(self._vehicle)
        return replace_gains(self._vehicle.stabilizer, gains, self._set(gains))

    def position_loop(self) -> PositionLoop:
        """Return gains and limits of the height and position loops as they are set."""
        return replace_gains(self._vehicle.position, POSITION_GAINS, self._set(POSITION_GAINS))

    def reference(self) -> list[dict[str, str | float]]:
        """Return what is to be known about each parameter."""
        return [
            {
                "name": parameter.name,
                "type": "INT32" if isinstance(parameter.default, int) else "REAL32",
                "default": _round_float32(parameter.default),
                "unit": parameter.unit,
                "allowed": parameter.allowed,
                "meaning": parameter.meaning,
            }
            for parameter in self.table
        ]

    def _set(self, gains: Mapping[str, TunableGain]) -> dict[str, float]:
        """Return those of the gains that are not as they were at start."""
        return {name: self[name] for name in gains if self[name] != self.table[self._index[name]].default}
