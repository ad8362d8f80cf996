"""The airframe: what is simulated and what a design model is made from. Numbers only, read from a TOML file."""

from dataclasses import field
from enum import Enum
from pathlib import Path
from typing import Annotated

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from firmware_model.files import read_toml, shipped

VEHICLES = Path(__file__).parent / "vehicles"

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
PositiveVector = tuple[Positive, Positive, Positive]
Vector = tuple[Finite, Finite, Finite]
_STRICT = ConfigDict(extra="forbid")


class NoiseModel(Enum):
    """How the gyro's signal-to-noise ratio is understood."""

    CONSTANT = "constant"
    """White noise of one strength: the ratio holds at the reference rate."""
    STATE_DEPENDENT = "state-dependent"
    """White noise in proportion to the rate itself, axis by axis (the paper's wording)."""


@dataclass(frozen=True, slots=True, kw_only=True, config=_STRICT)
class Gyro:
    """Three-axis rate gyro."""

    snr_db: Finite
    """[dB] ratio of the rms of `reference_rate` to the rms of the noise of one 250 Hz sample."""
    reference_rate: Positive
    """[rad/s] rms rate at which `snr_db` is stated."""
    range: Positive
    """[rad/s] largest magnitude that is measured; more is clipped."""
    noise_model: NoiseModel = NoiseModel.CONSTANT
    """Whether the noise is constant or in proportion to the rate."""
    bias_B: Vector = (0.0, 0.0, 0.0)
    """[rad/s] B, constant error."""

    @property
    def noise_ratio(self) -> float:
        """[-] rms of the noise divided by the rms of the rate."""
        return float(10.0 ** (-self.snr_db / 20.0))

    @property
    def noise_density(self) -> float:
        """[rad/s/sqrt(Hz)] one-sided: the rms of a 250 Hz sample spread over its 125 Hz of bandwidth."""
        return float(self.noise_ratio * self.reference_rate / 125.0**0.5)


@dataclass(frozen=True, slots=True, kw_only=True, config=_STRICT)
class Stabilizer:
    """Gains of the on-board cascade, as angular acceleration, so that they do not depend on the inertia."""

    angle_p: Positive
    """[1/s] rate asked for per radian of attitude error."""
    rate_p: PositiveVector
    """[1/s] B, angular acceleration per rate error."""
    rate_i: tuple[NonNegative, NonNegative, NonNegative]
    """[1/s^2] B, angular acceleration per integrated rate error."""
    rate_d: tuple[NonNegative, NonNegative, NonNegative]
    """[-] B, angular acceleration per filtered derivative of the rate."""
    derivative_cutoff: Positive
    """[Hz] corner of the first-order filter on the derivative."""
    rate_limit: Positive
    """[rad/s] largest rate that the attitude loop asks for, each axis."""


@dataclass(frozen=True, slots=True, kw_only=True, config=_STRICT)
class Vehicle:
    """A multirotor as a rigid body with torque actuators."""

    name: str
    """Short name; the file's by default."""
    source: str
    """Where the numbers were published."""
    mass: Positive
    """[kg]."""
    inertia_B: PositiveVector
    """[kg*m^2] B, principal moments of inertia I_x, I_y, I_z."""
    rate_damping: NonNegative
    """[1/s] moment against the rate relative to the air, divided by the inertia."""
    actuator_lag: Positive
    """[s] time constant of the torque response."""
    torque_limit: PositiveVector
    """[N*m] B, largest torque about each axis; what 1.0 of a normed command means."""
    span: Positive
    """[m] rotor tip to rotor tip, the wing span b of the Dryden model's angular gusts."""
    gust_gain: NonNegative
    """[N*m/(m/s)] roll moment per lateral gust: rotor drag times height of the rotor plane above the centre of mass."""
    gust_yaw_ratio: NonNegative
    """[-] yaw moment per vertical gust, divided by `gust_gain`."""
    gyro: Gyro
    """Rate gyro."""
    stabilizer: Stabilizer
    """On-board cascade."""
    description: str = field(default="")
    """One line for people."""


def load_vehicle(name_or_path: str | Path) -> Vehicle:
    """Read a vehicle file, or a shipped one by its name.

    Raises
    ------
    ConfigError
        If there is no such file, or a key or value is not allowed.
    """
    return read_toml(Vehicle, name_or_path, VEHICLES)


def shipped_vehicles() -> tuple[str, ...]:
    """Return the names of the shipped vehicles."""
    return shipped(VEHICLES)
