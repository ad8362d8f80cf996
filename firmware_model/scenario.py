"""A scripted flight: how long, at which rates, in which air, with which faults. Read from TOML, units in the keys."""

from dataclasses import field
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass

from firmware_model.events import ControllerHung, ControllerKilled, Event, ModeChange
from firmware_model.files import read_toml, shipped
from firmware_model.link import LinkFault
from firmware_model.requirement import Requirement
from firmware_model.vehicle import Finite, NonNegative, Positive, Vector

SCENARIOS = Path(__file__).parent / "scenarios"
_STRICT = ConfigDict(extra="forbid")


@dataclass(frozen=True, slots=True, kw_only=True, config=_STRICT)
class Dryden:
    """Continuous random gusts of MIL-F-8785C, low-altitude model (below 1000 ft), all six components."""

    kind: Literal["dryden"]
    """Names this primitive."""
    wind_speed_20ft_mps: Positive
    """[m/s] mean wind speed at 20 ft: light 7.7, moderate 15.4, severe 23.2."""
    airspeed_mps: Positive | None = None
    """[m/s] speed at which the frozen field passes; the mean wind speed by default, the rule for hover."""


@dataclass(frozen=True, slots=True, kw_only=True, config=_STRICT)
class OneMinusCosine:
    """Discrete gust `amplitude / 2 * (1 - cos(2 pi (t - start) / length))`, zero outside its length."""

    kind: Literal["one_minus_cosine"]
    """Names this primitive."""
    amplitude_mps: Vector
    """[m/s] B, gust at its peak, blowing toward."""
    start_s: NonNegative
    """[s] begin."""
    length_s: Positive
    """[s] from calm to calm."""


@dataclass(frozen=True, slots=True, kw_only=True, config=_STRICT)
class Constant:
    """Steady mean wind: a free vehicle drifts with it; on the test stand it is trimmed out and gives no moment."""

    kind: Literal["constant"]
    """Names this primitive."""
    velocity_mps: Vector
    """[m/s] N (north, east, down), blowing toward: (5, 0, 0) is a wind from the south."""


@dataclass(frozen=True, slots=True, kw_only=True, config=_STRICT)
class Sine:
    """Direct moment `amplitude * sin(rate * t + phase)`."""

    kind: Literal["sine"]
    """Names this primitive."""
    amplitude_nm: Vector
    """[N*m] B."""
    rate_rad_s: Positive
    """[rad/s] angular frequency."""
    phase_rad: Finite = 0.0
    """[rad] at t = 0."""


@dataclass(frozen=True, slots=True, kw_only=True, config=_STRICT)
class Square:
    """Direct moment of full amplitude all the time, `amplitude * sign(sin(rate * t + phase))`: bang-bang."""

    kind: Literal["square"]
    """Names this primitive."""
    amplitude_nm: Vector
    """[N*m] B."""
    rate_rad_s: Positive
    """[rad/s] angular frequency; the sign changes twice a period."""
    phase_rad: Finite = 0.0
    """[rad] at t = 0."""


@dataclass(frozen=True, slots=True, kw_only=True, config=_STRICT)
class Step:
    """Direct moment that is there from `start` on, to the end."""

    kind: Literal["step"]
    """Names this primitive."""
    amplitude_nm: Vector
    """[N*m] B."""
    start_s: NonNegative = 0.0
    """[s] begin."""


@dataclass(frozen=True, slots=True, kw_only=True, config=_STRICT)
class GyroFault:
    """What is wrong with the gyro beyond the vehicle's own description."""

    bias_rad_s: Vector = (0.0, 0.0, 0.0)
    """[rad/s] B, added to the vehicle's bias."""
    noise: bool = True
    """False switches the noise off."""


Wind = Annotated[Dryden | OneMinusCosine | Constant, Field(discriminator="kind")]
Moment = Annotated[Sine | Square | Step, Field(discriminator="kind")]


@dataclass(frozen=True, slots=True, kw_only=True, config=_STRICT)
class Scenario:
    """One scripted flight; times are multiples of the sample time."""

    name: str
    """Short name; the file's by default."""
    description: str
    """One line: what it shows."""
    duration_s: Positive
    """[s] simulated time from the first commanded sample."""
    translation: Literal["held", "free"] = "held"
    """Held on a test stand, as in the paper, where the vehicle turns and does not move; or in free flight."""
    altitude_m: Positive = 10.0
    """[m] height above ground, where the air model is evaluated and the vehicle is held, or its free flight begins."""
    control_rate_hz: Annotated[int, Field(ge=10, le=1000)] = 250
    """[Hz] samples and commands."""
    physics_rate_hz: Annotated[int, Field(ge=100, le=10000)] = 1000
    """[Hz] integration steps, a multiple of `control_rate_hz`."""
    delay_samples: Annotated[int, Field(ge=0, le=50)] = 1
    """[samples] from a sample to the moment its command acts."""
    wind: tuple[Wind, ...] = ()
    """Wind, added up."""
    moment: tuple[Moment, ...] = ()
    """Moments that act directly, added up."""
    gyro: GyroFault = field(default_factory=GyroFault)
    """Gyro faults."""
    link: tuple[LinkFault, ...] = ()
    """Faults of the link to the controller, and back."""
    event: tuple[Event, ...] = ()
    """What happens at stated times."""
    require: tuple[Requirement, ...] = ()
    """What must hold."""

    @model_validator(mode="after")
    def _rates_fit(self) -> Self:
        if self.physics_rate_hz % self.control_rate_hz:
            raise ValueError("physics_rate_hz must be a multiple of control_rate_hz")
        if 1_000_000 % self.control_rate_hz:
            raise ValueError("control_rate_hz must divide 1,000,000, so that stamps are whole microseconds")
        if sum(isinstance(item, Dryden) for item in self.wind) > 1:
            raise ValueError("wind: at most one 'dryden', its components are not independent of a second one's")
        return self

    @model_validator(mode="after")
    def _ground_is_stiff(self) -> Self:
        if self.translation == "free" and self.physics_rate_hz < 500:
            raise ValueError("physics_rate_hz must be at least 500 in free flight, for the feet on the ground")
        return self

    @model_validator(mode="after")
    def _one_controller_at_a_time(self) -> Self:
        killed = [item for item in self.event if isinstance(item, ControllerKilled)]
        if len(killed) > 1:
            raise ValueError("event: at most one 'controller_killed', one spare controller stands ready")
        return self

    @model_validator(mode="after")
    def _windows_are_flown(self) -> Self:
        for number, item in enumerate(self.require):
            begin, end = self.window(item)
            if end > self.samples:
                raise ValueError(f"require.{number}: to_s must not be later than the end, {self.duration_s} s")
            if end - begin < 2:
                raise ValueError(f"require.{number}: a window has at least two samples of {self.dt} s")
        return self

    @property
    def scripts_controller(self) -> bool:
        """Whether modes, the controller or the link to it are part of the script: then messages must be flown."""
        return bool(self.link) or any(
            isinstance(item, (ModeChange, ControllerHung, ControllerKilled)) for item in self.event
        )

    @property
    def free(self) -> bool:
        """Whether the vehicle flies, and is not held on the stand."""
        return self.translation == "free"

    @property
    def mean_wind_N(self) -> tuple[float, float, float]:
        """[m/s] N, sum of the steady winds, blowing toward."""
        winds = [item.velocity_mps for item in self.wind if isinstance(item, Constant)]
        north, east, down = (sum(wind[i] for wind in winds) for i in range(3))
        return north, east, down

    @property
    def samples(self) -> int:
        """Number of samples that are flown."""
        return round(self.duration_s * self.control_rate_hz)

    def window(self, requirement: Requirement) -> tuple[int, int]:
        """Return the number of the first sample of a requirement's window, and that of the first after it."""
        end_s = self.duration_s if requirement.to_s is None else requirement.to_s
        return round(requirement.from_s * self.control_rate_hz), round(end_s * self.control_rate_hz)

    @property
    def sample_us(self) -> int:
        """[us] from sample to sample."""
        return 1_000_000 // self.control_rate_hz

    @property
    def dt(self) -> float:
        """[s] from sample to sample."""
        return 1.0 / self.control_rate_hz


def load_scenario(name_or_path: str | Path) -> Scenario:
    """Read a scenario file, or a shipped one by its name.

    Raises
    ------
    ConfigError
        If there is no such file, or a key or value is not allowed.
    """
    return read_toml(Scenario, name_or_path, SCENARIOS)


def shipped_scenarios() -> tuple[str, ...]:
    """Return the names of the shipped scenarios."""
    return shipped(SCENARIOS)
