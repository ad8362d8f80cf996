"""A scripted flight: how long, at which rates, in which air, with which faults. Read from TOML, units in the keys."""

import math
from dataclasses import field
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator
from pydantic.dataclasses import dataclass

from firmware_model.config.events import ControllerHang, ControllerKill, Event, ModeChange
from firmware_model.config.files import Name, list_shipped, read_toml
from firmware_model.config.link_faults import LinkFault
from firmware_model.config.moments import Moment
from firmware_model.config.plant_events import ActuatorLag, AttitudeReference, GyroBias, PlantEvent
from firmware_model.config.requirement import AXES, Metric, Requirement
from firmware_model.config.vehicle import NonNegative, Vector
from firmware_model.config.wind import STRICT, Dryden, Shear, Wind
from firmware_model.config.wind_table import fill_replay_rows

SCENARIOS = Path(__file__).parent / "data" / "scenarios"
Angle = Annotated[float, Field(ge=-180.0, le=180.0)]


def _countable(tables: Any) -> Any:
    """Refuse more tables than any script needs before each of them is looked at."""
    if isinstance(tables, list) and len(tables) > 1000:
        raise ValueError(f"there are {len(tables):,} of them, 1,000 are the most")
    return tables


_MANY = BeforeValidator(_countable)


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class GyroFault:
    """What is wrong with the gyro beyond the vehicle's own description."""

    bias_rad_s: Vector = (0.0, 0.0, 0.0)
    """[rad/s] B, added to the vehicle's bias."""
    noise: bool = True
    """False switches the noise off."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class AccelerometerFault:
    """What is wrong with the accelerometer beyond the vehicle's own description."""

    bias_mps2: Vector = (0.0, 0.0, 0.0)
    """[m/s^2] B, added to the vehicle's bias."""
    noise: bool = True
    """False switches the noise off."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Scenario:
    """One scripted flight; times are multiples of the sample time.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from gustproof import load_scenario
    >>> day = replace(load_scenario("paper-turbulence"), duration_s=20.0, delay_samples=2)
    >>> (day.samples, day.dt)
    (5000, 0.004)
    """

    name: Name
    """Short name, part of the names of files; the file's by default."""
    description: str
    """One line: what it shows."""
    duration_s: Annotated[float, Field(gt=0.0, le=86_400.0)]
    """[s] simulated time from the first commanded sample, up to a day."""
    translation: Literal["held", "free"] = "held"
    """Held on a test stand, as in the paper, where the vehicle turns and does not move; or in free flight."""
    altitude_m: Annotated[float, Field(gt=0.0, le=10_000.0)] = 10.0
    """[m] height above ground, where the air model is evaluated and the vehicle is held, or its free flight begins."""
    control_rate_hz: Annotated[int, Field(ge=10, le=1000)] = 250
    """[Hz] samples and commands."""
    physics_rate_hz: Annotated[int, Field(ge=100, le=10000)] = 1000
    """[Hz] integration steps, a multiple of `control_rate_hz`."""
    delay_samples: Annotated[int, Field(ge=0, le=50)] = 1
    """[samples] from a sample to the moment its command acts."""
    initial_attitude_deg: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """[deg] roll, pitch, yaw in which the flight begins, at rest; a vehicle on the ground stands level."""
    gust_scale: NonNegative = 1.0
    """[-] all gusts times this; the mean wind stays."""
    wind: Annotated[tuple[Wind, ...], _MANY] = ()
    """Wind, added up."""
    moment: Annotated[tuple[Moment, ...], _MANY] = ()
    """Moments that act directly, added up."""
    gyro: GyroFault = field(default_factory=GyroFault)
    """Gyro faults."""
    accelerometer: AccelerometerFault = field(default_factory=AccelerometerFault)
    """Accelerometer faults."""
    link: Annotated[tuple[LinkFault, ...], _MANY] = ()
    """Faults of the link to the controller, and back."""
    event: Annotated[tuple[Event, ...], _MANY] = ()
    """What happens at stated times."""
    require: Annotated[tuple[Requirement, ...], _MANY] = ()
    """What must hold."""

    @model_validator(mode="after")
    def _check_rates(self) -> Self:
        if self.physics_rate_hz % self.control_rate_hz:
            raise ValueError("physics_rate_hz must be a multiple of control_rate_hz")
        if 1_000_000 % self.control_rate_hz:
            raise ValueError("control_rate_hz must divide 1,000,000, so that stamps are whole microseconds")
        if not self.samples:
            raise ValueError(f"duration_s must be at least a sample, {self.dt} s")
        return self

    @model_validator(mode="after")
    def _check_phase_range(self) -> Self:
        for key, item in [*(("wind", item) for item in self.wind), *(("moment", item) for item in self.moment)]:
            rates = [getattr(item, name, 0.0) for name in ("rate_rad_s", "rate_from_rad_s", "rate_to_rad_s")]
            if max(rates) * self.duration_s + abs(getattr(item, "phase_rad", 0.0)) > 1e5:
                raise ValueError(f"{key}: a '{item.kind}' may turn through 1e5 rad in duration_s, no farther")
        return self

    @model_validator(mode="after")
    def _check_single_field(self) -> Self:
        if sum(isinstance(item, Dryden) for item in self.wind) > 1:
            raise ValueError("wind: at most one 'dryden', its components are not independent of a second one's")
        if sum(isinstance(item, Shear) for item in self.wind) > 1:
            raise ValueError("wind: at most one 'shear', there is one ground")
        return self

    @model_validator(mode="after")
    def _check_ground_rate(self) -> Self:
        if self.translation == "free" and self.physics_rate_hz < 500:
            raise ValueError("physics_rate_hz must be at least 500 in free flight, for the feet on the ground")
        return self

    @model_validator(mode="after")
    def _check_single_kill(self) -> Self:
        killed = [item for item in self.event if isinstance(item, ControllerKill)]
        if len(killed) > 1:
            raise ValueError("event: at most one 'controller_killed', one spare controller stands ready")
        return self

    @model_validator(mode="after")
    def _check_windows(self) -> Self:
        for number, item in enumerate(self.require):
            begin, end = self.window(item)
            if end > self.samples:
                raise ValueError(f"require.{number}: to_s must not be later than the end, {self.duration_s} s")
            if end - begin < 2:
                raise ValueError(f"require.{number}: a window has at least two samples of {self.dt} s")
            if item.metric is Metric.OVERSHOOT and not self._reference_step(item):
                raise ValueError(f"require.{number}: the window has no step of the reference in {item.axis}")
        return self

    @property
    def unflown(self) -> tuple[str, ...]:
        """What the script says and no flight of it shows, a line each."""
        late = f"not before the end, {self.duration_s} s: it is never flown"
        begins = [
            *((f"event.{i}: at_s {each.at_s} is", each.at_s) for i, each in enumerate(self.event)),
            *(
                (f"{key}.{i}: start_s {each.start_s} is", each.start_s)
                for key in ("wind", "moment", "link")
                for i, each in enumerate(getattr(self, key))
                if hasattr(each, "start_s")
            ),
        ]
        drifts = [i for i, each in enumerate(self.require) if each.metric is Metric.DRIFT and not self.free]
        return (
            *(f"{what} {late}" for what, begin_s in begins if self.sample_at(begin_s) >= self.samples),
            *(f"require.{i}: drift_m of a vehicle that is held is 0: give translation = 'free'" for i in drifts),
        )

    @property
    def has_link_script(self) -> bool:
        """Whether modes, the controller or the link to it are part of the script: then messages must be flown."""
        return bool(self.link) or any(
            isinstance(item, (ModeChange, ControllerHang, ControllerKill)) for item in self.event
        )

    @property
    def free(self) -> bool:
        """Whether the vehicle flies, and is not held on the stand."""
        return self.translation == "free"

    @model_validator(mode="after")
    def _check_events(self) -> Self:
        drifts = sorted((item for item in self.event if isinstance(item, GyroBias)), key=lambda item: item.at_s)
        for earlier, later in pairwise(drifts):
            if later.at_s < earlier.at_s + earlier.over_s:
                raise ValueError(f"event: a 'gyro_bias' at {later.at_s} s begins before the one before it ends")
        for item in self.event:
            if isinstance(item, ActuatorLag) and item.lag_s * self.physics_rate_hz < 1.0:
                raise ValueError("event: lag_s of 'actuator_lag' must be at least a step, 1 / physics_rate_hz")
        return self

    @property
    def plant_events(self) -> tuple[PlantEvent, ...]:
        """Events of the plant and the reference."""
        return tuple(item for item in self.event if isinstance(item, PlantEvent))

    @property
    def references(self) -> tuple[tuple[int, Vector], ...]:
        """Stamps [us] of the samples from which on the law is to hold another attitude, as roll, pitch, yaw [rad]."""
        turns = sorted((item for item in self.event if isinstance(item, AttitudeReference)), key=lambda item: item.at_s)
        return tuple((self.sample_at(item.at_s) * self.sample_us, item.euler) for item in turns)

    def sample_at(self, time_s: float) -> int:
        """Return the first sample at or after a time [s]; half a microsecond is not after it."""
        return math.ceil((time_s * 1e6 - 0.5) / self.sample_us)

    @property
    def samples(self) -> int:
        """Number of samples that are flown."""
        return round(self.duration_s * self.control_rate_hz)

    def window(self, requirement: Requirement) -> tuple[int, int]:
        """Return the number of the first sample of a requirement's window, and that of the first after it."""
        end = self.samples if requirement.to_s is None else self.sample_at(requirement.to_s)
        return self.sample_at(requirement.from_s), end

    def _reference_step(self, requirement: Requirement) -> float:
        """Return by how much [rad] the reference of a requirement's axis changes from before its window to its end."""
        begin, end = self.window(requirement)
        axis = AXES.index(requirement.axis or "roll")
        before, after = self.reference_at(begin - 1), self.reference_at(end - 1)
        return after[axis] - before[axis]

    def reference_at(self, sample: int) -> Vector:
        """Return roll, pitch, yaw [rad] that the law is to hold at a sample; level before the first."""
        held = (0.0, 0.0, 0.0)
        for time_us, euler in self.references:
            held = euler if time_us <= sample * self.sample_us else held
        return held

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

    Examples
    --------
    >>> from gustproof import load_scenario
    >>> load_scenario("paper-turbulence").duration_s
    60.0
    """
    return read_toml(Scenario, name_or_path, SCENARIOS, fill_replay_rows)


def list_scenarios() -> tuple[str, ...]:
    """Return the names of the shipped scenarios.

    Examples
    --------
    >>> from gustproof import list_scenarios
    >>> "paper-turbulence" in list_scenarios()
    True
    """
    return list_shipped(SCENARIOS)
