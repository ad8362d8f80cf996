"""Scripted flight: duration, rates, air, faults and requirements. A TOML file with units in its keys."""

import math
from dataclasses import field, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from firmware_model.config import events
from firmware_model.config.fields import NOT_TRUTH, Duration, NonNegative, Vector, strict_dataclass
from firmware_model.config.files import Name, list_shipped, read_toml, shipped_path
from firmware_model.config.link_faults import LinkFault
from firmware_model.config.requirement import Metric, Requirement
from firmware_model.config.vehicle import ON_BOARD, Vehicle
from firmware_model.config.waveforms import DRYDEN_CEILING_M, Moment, RandomGusts, Shear, Wind
from firmware_model.config.wind_table import fill_replay_rows
from firmware_model.errors import ConfigError
from firmware_model.types import AXES

SCENARIOS = Path(__file__).parent / "data" / "scenarios"
CONTROL_RATE_HZ = 250
"""[Hz] Samples of a scenario that does not say."""
MOST_DELAY = 50
"""[samples] largest delay of a scenario."""
Angle = Annotated[float, Field(ge=-180.0, le=180.0), NOT_TRUTH]


def _limit_count(tables: Any) -> Any:
    """Reject more tables than any script needs, before each of them is validated."""
    if isinstance(tables, list) and len(tables) > 1000:
        raise ValueError(f"there are {len(tables):,} of them, 1,000 are allowed")
    return tables


_MANY = BeforeValidator(_limit_count)


@strict_dataclass
class GyroFault:
    """Gyro errors on top of those of the vehicle."""

    bias_rad_s: Vector = (0.0, 0.0, 0.0)
    """[rad/s] B, added to the vehicle's bias."""
    noise: bool = True
    """False switches the noise off."""


@strict_dataclass
class AccelerometerFault:
    """Accelerometer errors on top of those of the vehicle."""

    bias_mps2: Vector = (0.0, 0.0, 0.0)
    """[m/s^2] B, added to the vehicle's bias."""
    noise: bool = True
    """False switches the noise off."""


@strict_dataclass
class NoiseRotation:
    """Turn of all random numbers of gusts and sensors: noise becomes cos(angle) noise + sin(angle) other noise."""

    seed: Annotated[int, Field(ge=0, lt=2**32), NOT_TRUTH]
    """Seed of the other noise."""
    angle_rad: Annotated[float, Field(ge=0.0, le=math.pi / 2.0), NOT_TRUTH]
    """[rad] 0 leaves the noise, pi/2 replaces it."""


@strict_dataclass
class Scenario:
    """Scripted flight; times are multiples of the sample time.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from gustproof import load_scenario
    >>> day = replace(load_scenario("paper-turbulence"), duration_s=20.0, delay_samples=2)
    >>> (day.samples, day.dt)
    (5000, 0.004)
    """

    name: Name
    """Short name, part of file names; the file's by default."""
    description: str
    """One line that describes the scenario to users."""
    duration_s: Duration
    """[s] simulated time from the first commanded sample, up to a day."""
    translation: Literal["held", "free", "position_hold"] = "held"
    """Held on a test stand, as in the paper, free in attitude only; or in free flight. With position_hold the vehicle's
    position loop flies around the controller: it gives the roll and pitch to track, and the thrust."""
    altitude_m: Annotated[float, Field(gt=0.0, le=10_000.0), NOT_TRUTH] = 10.0
    """[m] height above ground: of the air model, and of the vehicle on the stand or at the start of free flight."""
    control_rate_hz: Annotated[int, Field(ge=10, le=2000), NOT_TRUTH] = CONTROL_RATE_HZ
    """[Hz] samples and commands."""
    physics_rate_hz: Annotated[int, Field(ge=100, le=10000), NOT_TRUTH] = 1000
    """[Hz] integration steps, a multiple of `control_rate_hz`."""
    delay_samples: Annotated[int, Field(ge=0, le=MOST_DELAY), NOT_TRUTH] = 1
    """[samples] from a sample until its command acts."""
    initial_attitude_deg: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """[deg] initial roll, pitch, yaw, at rest; a vehicle on the ground stands level."""
    gust_scale: NonNegative = 1.0
    """[-] factor on all gusts; the mean wind stays."""
    wind: Annotated[tuple[Wind, ...], _MANY] = ()
    """Winds; they add up."""
    moment: Annotated[tuple[Moment, ...], _MANY] = ()
    """Direct moments; they add up."""
    gyro: GyroFault = field(default_factory=GyroFault)
    """Gyro faults."""
    accelerometer: AccelerometerFault = field(default_factory=AccelerometerFault)
    """Accelerometer faults."""
    link: Annotated[tuple[LinkFault, ...], _MANY] = ()
    """Faults of the link to and from the controller."""
    event: Annotated[tuple[events.Event, ...], _MANY] = ()
    """Events at stated times."""
    require: Annotated[tuple[Requirement, ...], _MANY] = ()
    """Requirements."""
    turn: Annotated[tuple[NoiseRotation, ...], _MANY] = ()
    """Turns, in order, of the random numbers that the flight's seed gives; `campaign rare` finds them."""

    @model_validator(mode="after")
    def _check_rates(self) -> Self:
        if self.physics_rate_hz % self.control_rate_hz:
            raise ValueError("physics_rate_hz must be a multiple of control_rate_hz")
        if self.free and self.physics_rate_hz < 500:
            raise ValueError("physics_rate_hz must be at least 500 in free flight, for the feet on the ground")
        if not self.samples:
            raise ValueError(f"duration_s must be at least a sample, {self.dt} s")
        return self

    @model_validator(mode="after")
    def _check_phase_range(self) -> Self:
        for key, item in [*(("wind", item) for item in self.wind), *(("moment", item) for item in self.moment)]:
            rates = [getattr(item, name, 0.0) for name in ("rate_rad_s", "rate_from_rad_s", "rate_to_rad_s")]
            if max(rates) * self.duration_s + abs(getattr(item, "phase_rad", 0.0)) > 1e5:
                raise ValueError(f"{key}: a '{item.kind}' may turn through 1e5 rad in duration_s at most")
        return self

    @model_validator(mode="after")
    def _check_single_tables(self) -> Self:
        for kind, reason in (
            (RandomGusts, "wind: at most one 'dryden' or 'von_karman', a second one would not be independent of it"),
            (Shear, "wind: at most one 'shear', there is one ground"),
            (events.ControllerKill, "event: at most one 'controller_killed', there is one spare controller"),
        ):
            if sum(isinstance(item, kind) for item in (*self.wind, *self.event)) > 1:
                raise ValueError(reason)
        turbulence = next((item for item in self.wind if isinstance(item, RandomGusts)), None)
        if self.altitude_m > DRYDEN_CEILING_M and turbulence:
            model = f"'{turbulence.kind}' is the low-altitude model, valid to {DRYDEN_CEILING_M} m (1000 ft)"
            raise ValueError(f"altitude_m: {model}, not at {self.altitude_m:g} m")
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
        """One line for each table that no flight shows: one after the end, or the drift of a held vehicle."""
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
    def unread(self) -> str:
        """Line on an event that our own autopilot does not notice, as it reads no satellites; empty without one."""
        lost = next((i for i, each in enumerate(self.event) if isinstance(each, events.GpsLoss)), None)
        return "" if lost is None else f"event.{lost}: gps_lost is of real autopilots, no law here reads satellites"

    @property
    def has_link_script(self) -> bool:
        """True if the script involves modes, the controller or its link."""
        return bool(self.link) or any(isinstance(item, events.ControllerEvent) for item in self.event)

    @property
    def needs_messages(self) -> bool:
        """True if the script kills the controller or sets modes: what follows is decided by messages in flight."""
        return any(isinstance(item, events.ControllerKill | events.ModeChange) for item in self.event)

    @property
    def free(self) -> bool:
        """True in free flight, False on the stand."""
        return self.translation != "held"

    @property
    def holds_place(self) -> bool:
        """True if the vehicle's position loop flies around the controller."""
        return self.translation == "position_hold"

    @model_validator(mode="after")
    def _check_place(self) -> Self:
        if not self.holds_place:
            return self
        if self.has_link_script:
            raise ValueError(
                "translation: 'position_hold' has no link, controller or mode events: set-points need them"
            )
        for item in self.event:
            if isinstance(item, events.AttitudeReference) and any(item.euler_deg[:2]):
                raise ValueError("event: the roll and pitch of an 'attitude' are those of the position loop: give 0")
        return self

    @model_validator(mode="after")
    def _check_events(self) -> Self:
        drifts = sorted((item for item in self.event if isinstance(item, events.GyroBias)), key=lambda item: item.at_s)
        for earlier, later in pairwise(drifts):
            if later.at_s < earlier.at_s + earlier.over_s:
                raise ValueError(f"event: a 'gyro_bias' at {later.at_s} s begins before the one before it ends")
        for item in self.event:
            if isinstance(item, events.RotorFailure) and not self.free:
                raise ValueError("event: 'rotor_failure' needs translation = 'free'; the stand has 'actuator_effect'")
            if isinstance(item, events.ActuatorLag) and item.lag_s * self.physics_rate_hz < 1.0:
                raise ValueError("event: lag_s of 'actuator_lag' must be at least a step, 1 / physics_rate_hz")
        return self

    @property
    def plant_events(self) -> tuple[events.PlantEvent, ...]:
        """Events of the plant and the reference."""
        return tuple(item for item in self.event if isinstance(item, events.PlantEvent))

    def has_fix(self, time_s: float) -> bool:
        """Return whether the satellite receiver has a fix at a time [s]."""
        lost = (item for item in self.event if isinstance(item, events.GpsLoss))
        return not any(item.at_s <= time_s < item.at_s + (item.for_s or math.inf) for item in lost)

    @property
    def references(self) -> tuple[tuple[int, Vector], ...]:
        """Attitude references of the law: stamp [us] of the first sample, and roll, pitch, yaw [rad]."""
        changes = [item for item in self.event if isinstance(item, events.AttitudeReference)]
        changes.sort(key=lambda item: item.at_s)
        return tuple((self.sample_at(item.at_s) * self.sample_us, item.euler) for item in changes)

    def sample_at(self, time_s: float) -> int:
        """Return the first sample at or after a time [s], with a tolerance of half a microsecond."""
        return math.ceil((time_s * 1e6 - 0.5) / self.sample_us)

    @property
    def samples(self) -> int:
        """Number of samples of the flight."""
        return self.nearest_sample(self.duration_s)

    def nearest_sample(self, time_s: float) -> int:
        """Return the sample nearest to a time [s]."""
        return round(time_s * 1e6 / self.sample_us)

    def window(self, requirement: Requirement) -> tuple[int, int]:
        """Return the first sample of a requirement's window, and the first after it."""
        end = self.samples if requirement.to_s is None else self.sample_at(requirement.to_s)
        return self.sample_at(requirement.from_s), end

    def _reference_step(self, requirement: Requirement) -> float:
        """Return the change [rad] of the reference of a requirement's axis, from before its window to its end."""
        begin, end = self.window(requirement)
        axis = AXES.index(requirement.axis or "roll")
        before, after = self.reference_at(begin - 1), self.reference_at(end - 1)
        return after[axis] - before[axis]

    def reference_at(self, sample: int) -> Vector:
        """Return the attitude reference at a sample as roll, pitch, yaw [rad]; level before the first."""
        held = (0.0, 0.0, 0.0)
        for time_us, euler in self.references:
            held = euler if time_us <= sample * self.sample_us else held
        return held

    @property
    def sample_us(self) -> int:
        """[us] from sample to sample, whole as in stamps: 3333 at 300 Hz."""
        return round(1_000_000 / self.control_rate_hz)

    @property
    def dt(self) -> float:
        """[s] from sample to sample."""
        return sample_time(self.control_rate_hz)

    @property
    def physics_dt(self) -> float:
        """[s] from integration step to integration step."""
        return self.sample_us / (1_000_000 * (self.physics_rate_hz // self.control_rate_hz))


def sample_time(rate_hz: float) -> float:
    """Return the time [s] from sample to sample at a rate, of whole microseconds as stamps are: .003333 at 300 Hz."""
    return round(1_000_000 / rate_hz) / 1_000_000


def load_scenario(name_or_path: str | Path) -> Scenario:
    """Return a scenario from a file, or a shipped one by its name.

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


def with_measured_delay(scenario: Scenario, vehicle: Vehicle, *, on_board: bool = False) -> Scenario:
    """Return the scenario with a sample and the delay that a log of the vehicle measured, if its own is shorter.

    Loops `on_board` are those of the autopilot that wrote the log: its stamps tell their whole delay. It then stands in
    the place of the one sample that is usual.

    Raises
    ------
    ConfigError
        If it is longer than a scenario's delay may be.
    """
    command = vehicle.command
    whole = on_board and command is not None and command.autopilot in ON_BOARD
    late = 0 if command is None else command.samples(scenario.dt) + (not whole)
    if late > MOST_DELAY:
        raise ConfigError(
            f"vehicle '{vehicle.name}': command.delay is {late} samples of scenario '{scenario.name}', "
            f"{MOST_DELAY} are allowed"
        )
    is_usual = whole and scenario.delay_samples == 1
    return replace(scenario, delay_samples=late) if is_usual or late > scenario.delay_samples else scenario


def scenario_path(name_or_path: str | Path) -> Path:
    """Return the path of a scenario file, or of a shipped one by its name.

    Raises
    ------
    ConfigError
        If none of that name is shipped.
    """
    return shipped_path("scenario", name_or_path, SCENARIOS)


def list_scenarios() -> tuple[str, ...]:
    """Return the names of the shipped scenarios.

    Examples
    --------
    >>> from gustproof import list_scenarios
    >>> "paper-turbulence" in list_scenarios()
    True
    """
    return list_shipped(SCENARIOS)
