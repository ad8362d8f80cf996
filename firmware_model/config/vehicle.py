"""Airframe data of a vehicle file (TOML): the numbers behind simulation and design models."""

import json
import math
from dataclasses import field, replace
from enum import Enum
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from pydantic_core import to_jsonable_python

from firmware_model.config.fields import (
    NOT_TRUTH,
    Finite,
    NonNegative,
    Positive,
    PositiveVector,
    Vector,
    strict_dataclass,
)
from firmware_model.config.files import Name, list_shipped, read_toml, shipped_path
from firmware_model.config.spreads import take_nominal
from firmware_model.config.units import check_units
from firmware_model.errors import ConfigError
from firmware_model.exact import right_inverse

GRAVITY = 9.80665
"""[m/s^2] standard gravity (3rd CGPM, 1901), down."""
VEHICLES = Path(__file__).parent / "data" / "vehicles"

MOST_ROTORS = 16
"""Outputs of a SERVO_OUTPUT_RAW message."""
Spin = Annotated[Literal[1, -1], NOT_TRUTH]


class NoiseModel(Enum):
    """Meaning of the gyro's signal-to-noise ratio."""

    CONSTANT = "constant"
    """White noise of one strength: the ratio holds at the reference rate."""
    STATE_DEPENDENT = "state-dependent"
    """White noise in proportion to the rate of each axis (the paper's wording)."""


@strict_dataclass
class Gyro:
    """Three-axis rate gyro."""

    snr_db: Finite
    """[dB] ratio of the rms of `reference_rate` to the rms of the noise of one 250 Hz sample."""
    reference_rate: Positive
    """[rad/s] rms rate at which `snr_db` is stated."""
    range: Positive
    """[rad/s] largest measured magnitude; beyond it the output is clipped."""
    noise_model: NoiseModel = NoiseModel.CONSTANT
    """Constant noise, or noise in proportion to the rate."""
    bias_B: Vector = (0.0, 0.0, 0.0)
    """[rad/s] B, constant error."""

    @property
    def noise_ratio(self) -> float:
        """[-] rms of the noise divided by the rms of the rate."""
        return float(10.0 ** (-self.snr_db / 20.0))

    @property
    def noise_density(self) -> float:
        """[rad/s/sqrt(Hz)] one-sided: rms of a 250 Hz sample, spread over its bandwidth of 125 Hz."""
        return float(self.noise_ratio * self.reference_rate / 125.0**0.5)


@strict_dataclass
class Accelerometer:
    """Three-axis accelerometer at the centre of mass; without entries in the file, an ideal one."""

    noise_density: NonNegative = 0.0
    """[m/s^2/sqrt(Hz)] one-sided, of white noise."""
    range: Positive = 16.0 * GRAVITY
    """[m/s^2] largest measured magnitude; beyond it the output is clipped."""
    bias_B: Vector = (0.0, 0.0, 0.0)
    """[m/s^2] B, constant error."""


@strict_dataclass
class Stabilizer:
    """Gains of the on-board cascade, as angular acceleration and so independent of the inertia."""

    angle_p: Positive
    """[1/s] commanded rate per radian of attitude error."""
    rate_p: PositiveVector
    """[1/s] B, angular acceleration per rate error."""
    rate_i: tuple[NonNegative, NonNegative, NonNegative]
    """[1/s^2] B, angular acceleration per integrated rate error."""
    rate_d: tuple[NonNegative, NonNegative, NonNegative]
    """[-] B, angular acceleration per filtered derivative of the rate."""
    derivative_cutoff: Positive
    """[Hz] corner of the first-order filter on the derivative."""
    rate_limit: Positive
    """[rad/s] largest rate that the attitude loop commands, each axis."""


@strict_dataclass
class Rotors:
    """Rotors, four or more; four in PX4's order for a quadrotor X: front right, rear left, front left, rear right."""

    position_B: Annotated[tuple[Vector, ...], Field(min_length=4, max_length=MOST_ROTORS)]
    """[m] B, (n, 3) hubs from the centre of mass."""
    spin: tuple[Spin, ...]
    """[-] (n,) 1 counter-clockwise seen from above (drag turns the nose right), -1 clockwise."""
    thrust_max: Positive
    """[N] largest thrust of one rotor; a thrust command of 1.0 means that of all rotors."""
    drag_ratio: Positive
    """[m] drag torque per thrust."""

    @property
    def count(self) -> int:
        """Number of rotors n."""
        return len(self.position_B)

    @property
    def total_thrust(self) -> float:
        """[N] largest thrust of all rotors."""
        return self.count * self.thrust_max

    @property
    def height(self) -> float:
        """[m] of the rotors above the centre of mass, on average."""
        return -sum(z for _, _, z in self.position_B) / self.count

    @property
    def wrench(self) -> NDArray[np.float64]:
        """(4, n) roll, pitch, yaw torque [N*m] and thrust [N] per thrust [N] of each rotor."""
        x, y, _ = np.array(self.position_B).T
        return np.array([-y, x, self.drag_ratio * np.array(self.spin), np.ones(self.count)])

    @property
    def allocation(self) -> NDArray[np.float64]:
        """(n, 4) thrust [N] of each rotor per torque [N*m] and thrust [N]; of least sum of squares, if n > 4."""
        return _allocation(self)

    @model_validator(mode="after")
    def _check_authority(self) -> Self:
        if len(self.spin) != self.count:
            raise ValueError(f"spin: {len(self.spin)} of them, for {self.count} rotors in position_B")
        if error := _find_rotor_error(self):
            raise ValueError(error)
        return self


@lru_cache(maxsize=64)  # a campaign makes many vehicles with the same rotors
def _allocation(rotors: Rotors) -> NDArray[np.float64]:
    allocation = right_inverse(rotors.wrench)
    allocation.flags.writeable = False
    return allocation


@lru_cache(maxsize=64)
def _find_rotor_error(rotors: Rotors) -> str:
    if np.linalg.cond(rotors.wrench) > 1e6:
        return "these rotors cannot produce roll, pitch and yaw independently: check spin"
    if np.min(rotors.allocation[:, 3]) <= 0.0:
        return "position_B: the centre of mass is not between the rotors, or their spins do not balance in hover"
    return ""


@strict_dataclass
class Gear:
    """Four feet at the corners of a rectangle."""

    half_length: Positive
    """[m] from the centre of mass to the feet, forward and backward."""
    half_width: Positive
    """[m] from the centre of mass to the feet, right and left."""
    height: Positive
    """[m] from the centre of mass down to the feet, without load."""
    sag: Positive
    """[m] deflection under the weight."""
    friction: Positive
    """[-] friction force per load."""


@strict_dataclass
class PositionLoop:
    """Gains and limits of the on-board height and position loops in free flight."""

    xy_p: Positive
    """[1/s] commanded horizontal velocity per position error."""
    xy_velocity_p: Positive
    """[1/s] acceleration per velocity error."""
    xy_velocity_i: NonNegative
    """[1/s^2] acceleration per integrated velocity error."""
    xy_velocity_max: Positive
    """[m/s] largest commanded horizontal velocity."""
    z_p: Positive
    """[1/s] commanded vertical velocity per height error."""
    z_velocity_p: Positive
    """[1/s] acceleration per velocity error."""
    z_velocity_i: NonNegative
    """[1/s^2] acceleration per integrated velocity error."""
    z_velocity_max_up: Positive
    """[m/s] fastest climb."""
    z_velocity_max_down: Positive
    """[m/s] fastest descent."""
    tilt_max: Annotated[float, Field(gt=0.0, lt=1.2), NOT_TRUTH]
    """[rad] largest commanded tilt."""


@strict_dataclass
class Battery:
    """Battery of cells in series, used in free flight; it is full at the start."""

    cells: Annotated[int, Field(ge=1, le=14), NOT_TRUTH]
    """Cells in series; BATTERY_STATUS tells up to 14."""
    capacity_ah: Positive
    """[A*h] charge from full to empty."""
    resistance_ohm: NonNegative
    """[ohm] of all cells and wires."""
    hover_current_a: Positive
    """[A] of all rotors in hover."""
    voltage_full: Annotated[float, Field(gt=0.0, le=4.6), NOT_TRUTH] = 4.2
    """[V] of a full cell without current, at which the rotors give `thrust_max`; of lithium polymer by default."""
    voltage_empty: Positive = 3.6
    """[V] of an empty cell without current; by default PX4's BAT1_V_EMPTY."""

    @property
    def hover_sag(self) -> float:
        """[-] thrust that a command gives in hover, full, of that at `voltage_full`: see `physics.battery`."""
        return max(1.0 - self.resistance_ohm * self.hover_current_a / (self.cells * self.voltage_full), 0.0) ** 2

    @model_validator(mode="after")
    def _check_voltage(self) -> Self:
        if self.voltage_empty >= self.voltage_full:
            raise ValueError("voltage_empty must be lower than voltage_full")
        return self


ON_BOARD = ("px4", "ardupilot")
"""Autopilots whose logs have commands of a scale of their own, stamped when its loops make them."""


class FullScale(Enum):
    """Source of the torque that a command of 1.0 of an autopilot gives."""

    MEASURED = "measured"
    """The log: `torque_limit`, whatever the rotors say."""
    ROTORS = "rotors"
    """The rotors, which are known."""
    UNKNOWN = "unknown"
    """Nothing: the log has no such command, and the rotors are assumed."""


@strict_dataclass
class MeasuredCommand:
    """Command to torque, as the log of a flight tells; `gustproof identify` writes it."""

    autopilot: Name
    """Writer of the log: px4, ardupilot, crazyflie, gustproof, mavlink or csv."""
    full_scale: FullScale
    """Source of the torque of a command of 1.0."""
    delay: NonNegative
    """[s] from a command to the start of its torque."""
    thrust_range: Annotated[float, Field(gt=0.0, le=1.0), NOT_TRUTH] = 1.0
    """[-] share of the largest thrust that the motors spanned: ArduPilot's MOT_SPIN_MAX less MOT_SPIN_MIN."""
    unmeasured: tuple[Literal["roll", "pitch", "yaw"], ...] = ()
    """Axes that the flight did not excite: their torque is assumed."""

    def samples(self, dt: float) -> int:
        """Return the delay in samples of `dt` [s], rounded up from a quarter: too little of it is unsafe."""
        return math.ceil(self.delay / dt - 0.25)


@strict_dataclass
class Vehicle:
    """Multirotor as a rigid body with torque actuators.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from gustproof import load_vehicle
    >>> heavy = replace(load_vehicle("iris"), name="heavy-iris", mass=1.8)
    >>> (heavy.mass, heavy.actuator_lag)
    (1.8, 0.025)
    """

    name: Name
    """Short name; the file's by default."""
    source: str
    """Publication that the numbers are from."""
    mass: Positive
    """[kg]."""
    inertia_B: PositiveVector
    """[kg*m^2] B, principal moments of inertia I_x, I_y, I_z."""
    actuator_lag: Positive
    """[s] time constant of the torque response."""
    torque_limit: PositiveVector
    """[N*m] B, largest torque about each axis; a normalised command of 1.0 means this."""
    span: Positive
    """[m] rotor tip to rotor tip: the wing span b in the Dryden model's angular gusts."""
    gust_gain: NonNegative
    """[N*m/(m/s)] roll moment per lateral gust: rotor drag times height of the rotor plane above the centre of mass."""
    gust_yaw_ratio: NonNegative
    """[-] yaw moment per vertical gust, divided by `gust_gain`."""
    heave_drag: NonNegative
    """[N/(m/s)] force of all rotors in hover per velocity of the air along their axis."""
    drag_area: NonNegative
    """[m^2] drag coefficient times area of the body."""
    gyro: Gyro
    """Rate gyro."""
    stabilizer: Stabilizer
    """On-board cascade."""
    rotors: Rotors
    """Rotors."""
    gear: Gear
    """Feet."""
    position: PositionLoop
    """On-board loops of height and position."""
    accelerometer: Accelerometer = field(default_factory=Accelerometer)
    """Accelerometer."""
    battery: Battery | None = None
    """Battery; by default the voltage never falls."""
    rate_damping: NonNegative | tuple[NonNegative, NonNegative, NonNegative] | None = None
    """[1/s] damping moment per rate, divided by the inertia, about every axis or B; by default of the rotors' drag."""
    command: MeasuredCommand | None = None
    """Command to torque as a log tells; by default the rotors give the torque, without delay."""
    description: str = field(default="")
    """One line that describes the vehicle to users."""

    @property
    def rotor_drag(self) -> float:
        """[N/(m/s)] force of all rotors in hover per velocity of the air in their plane, the cause of `gust_gain`."""
        return self.gust_gain / self.rotors.height

    @property
    def rate_damping_B(self) -> Vector:
        """[1/s] B, damping moment per rate relative to the air, divided by the inertia.

        Without `rate_damping` it is that of the rotors in hover, each with its part of the drag. Roll moves a rotor at
        (x, y) along its axis by y p, pitch by -x q. Yaw moves it in its plane by r sqrt(x^2 + y^2). Products of x and y
        cancel in a symmetric layout; the height of the rotor plane is left out.
        """
        if self.rate_damping is not None:
            return self.rate_damping if isinstance(self.rate_damping, tuple) else (self.rate_damping,) * 3
        x_square, y_square, _ = np.mean(np.square(self.rotors.position_B), axis=0).tolist()
        I_x, I_y, I_z = self.inertia_B
        roll, pitch = self.heave_drag * y_square / I_x, self.heave_drag * x_square / I_y
        return roll, pitch, self.rotor_drag * (x_square + y_square) / I_z

    @model_validator(mode="after")
    def _check_thrust(self) -> Self:
        if self.rotors.height <= 0.0:
            raise ValueError("rotors.position_B: the rotors must be above the centre of mass, z < 0 on average")
        if self.rotors.total_thrust <= 1.2 * GRAVITY * self.mass:
            raise ValueError("rotors.thrust_max: all rotors must lift 1.2 times the weight")
        if self.battery and self.battery.hover_sag * self.rotors.total_thrust <= GRAVITY * self.mass:
            raise ValueError("battery: at its voltage under hover_current_a the rotors must lift the weight")
        return self


def load_vehicle(name_or_path: str | Path) -> Vehicle:
    """Return a vehicle from a file, or a shipped one by its name; a number with a spread takes its nominal value.

    Raises
    ------
    ConfigError
        If there is no such file, a key or value is not allowed, or a number is in another unit.

    Examples
    --------
    >>> from gustproof import load_vehicle
    >>> load_vehicle("iris").inertia_B
    (0.029125, 0.029125, 0.055225)
    """
    vehicle = read_toml(Vehicle, name_or_path, VEHICLES, lambda document, path: take_nominal(document, str(path)))
    check_body(vehicle.inertia_B, vehicle.inertia_B, str(name_or_path))
    check_units(vehicle, str(name_or_path))
    return vehicle


def vehicle_path(name_or_path: str | Path) -> Path:
    """Return the path of a vehicle file, or of a shipped one by its name.

    Raises
    ------
    ConfigError
        If none of that name is shipped.
    """
    return shipped_path("vehicle", name_or_path, VEHICLES)


def check_body(low: Vector, high: Vector, source: str) -> None:
    """Reject an end `low` or `high` [kg*m^2] of an inertia that no rigid body has, whatever the other two are.

    No moment of inertia of a rigid body is larger than the sum of the other two. A flat plate reaches that sum.

    Raises
    ------
    ConfigError
        If there is one; the error names `source`.
    """
    for i, axis in enumerate("xyz"):
        j, k = (i + 1) % 3, (i + 2) % 3
        apart = max(low[j] - high[k], low[k] - high[j], 0.0)
        for value in (low[i], high[i]):
            if not apart * (1.0 - 1e-9) <= value <= (high[j] + high[k]) * (1.0 + 1e-9):
                raise ConfigError(
                    f"{source}: inertia_B: no rigid body has {value:g} about {axis}: each moment of inertia is at most "
                    "the sum of the other two"
                )


def list_vehicles() -> tuple[str, ...]:
    """Return the names of the shipped vehicles.

    Examples
    --------
    >>> from gustproof import list_vehicles
    >>> list_vehicles()
    ('iris', 'octo', 'paper')
    """
    return list_shipped(VEHICLES)


def vehicle_digest(vehicle: Vehicle) -> str:
    """Return the SHA-256 of all numbers of a vehicle: that of a copy under another name is the same.

    Examples
    --------
    >>> from dataclasses import replace
    >>> iris = load_vehicle("iris")
    >>> copies = replace(iris, name="my-iris"), replace(iris, mass=1.8)
    >>> [vehicle_digest(copy) == vehicle_digest(iris) for copy in copies]
    [True, False]
    """
    numbers = replace(vehicle, name="x", source="", description="", rate_damping=vehicle.rate_damping_B)
    return sha256(json.dumps(to_jsonable_python(numbers), sort_keys=True).encode()).hexdigest()
