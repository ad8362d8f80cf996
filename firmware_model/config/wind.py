"""The tables of the air, `[[wind]]`: each a primitive by its `kind`, all added up, each speed that of the air.

A vector blows toward where it points. A table gives `amplitude_mps` in its `frame`, or `speed_mps` and `from_deg`, the
bearing that a level wind comes from, as meteorologists say it. Mean wind (`constant`, `shear`) carries a free vehicle
along and is trimmed out on the test stand; all else are gusts, which push on the vehicle there too.
"""

import math
from typing import Annotated, Literal, Self

from pydantic import ConfigDict, FailFast, Field, model_validator
from pydantic.dataclasses import dataclass

from firmware_model.config.vehicle import Finite, NonNegative, Positive, Vector

STRICT = ConfigDict(extra="forbid")
KNOT = 0.514444
"""[m/s] 1852 m an hour."""
Frame = Literal["body", "ned"]
Rate = Annotated[float, Field(gt=0.0, le=3200.0)]
MOST_ROWS = 150_000
"""Rows of a `replay`: ten minutes at 250 Hz."""
Rows = Annotated[
    tuple[tuple[Finite, Finite, Finite, Finite], ...], FailFast(), Field(min_length=2, max_length=MOST_ROWS)
]
_INTENSITIES = {"light": 15.0 * KNOT, "moderate": 30.0 * KNOT, "severe": 45.0 * KNOT}  # MIL-F-8785C, figure 9: W20


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class TimeWindow:
    """What acts from a time to another."""

    start_s: NonNegative = 0.0
    """[s] begin."""
    stop_s: Positive | None = None
    """[s] end; to the end of the flight by default."""

    @model_validator(mode="after")
    def _check_interval(self) -> Self:
        if self.stop_s is not None and self.stop_s <= self.start_s:
            raise ValueError("stop_s must be later than start_s")
        return self


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Gust(TimeWindow):
    """A gust's direction and strength, and when it acts."""

    amplitude_mps: Vector | None = None
    """[m/s] at its peak, blowing toward, in `frame`."""
    frame: Frame | None = None
    """The vehicle's axes (`body`, the default of `amplitude_mps`), or north, east, down (`ned`)."""
    speed_mps: NonNegative | None = None
    """[m/s] at its peak, of a level wind."""
    from_deg: Finite | None = None
    """[deg] bearing that it comes from: 0 from the north, 90 from the east."""

    @model_validator(mode="after")
    def _check_one_direction(self) -> Self:
        _check_direction("amplitude_mps", self.amplitude_mps, self.speed_mps, self.from_deg)
        if self.from_deg is not None and self.frame == "body":
            raise ValueError("from_deg is a bearing: frame must be 'ned' or left out")
        return self

    @property
    def vector(self) -> Vector:
        """[m/s] at its peak, blowing toward, B or N."""
        return _wind_vector(self.amplitude_mps, self.speed_mps, self.from_deg)

    @property
    def is_earth_frame(self) -> bool:
        """Whether the vector is in N, and not in B."""
        return self.frame == "ned" or self.from_deg is not None


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class GustStep(Gust):
    """A gust that is there at once."""

    kind: Literal["step"]
    """Names this primitive."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class GustRamp(Gust):
    """A gust that grows linearly and then stays: a gust front."""

    kind: Literal["ramp"]
    """Names this primitive."""
    rise_s: Positive
    """[s] from calm to the peak."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class GustCosine(Gust):
    """Discrete gust `amplitude / 2 * (1 - cos(2 pi (t - start) / length))`, zero outside its length."""

    kind: Literal["one_minus_cosine"]
    """Names this primitive."""
    length_s: Positive
    """[s] from calm to calm."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class GustSine(Gust):
    """Gust `amplitude * sin(rate * (t - start) + phase)`."""

    kind: Literal["sine"]
    """Names this primitive."""
    rate_rad_s: Rate
    """[rad/s] angular frequency."""
    phase_rad: Finite = 0.0
    """[rad] at the start."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class GustSweep(Gust):
    """A sine, sin(0) at the start, whose angular frequency moves linearly from one to another until `stop_s`."""

    kind: Literal["sine_sweep"]
    """Names this primitive."""
    rate_from_rad_s: Rate
    """[rad/s] angular frequency at the start."""
    rate_to_rad_s: Rate
    """[rad/s] angular frequency at the end."""
    stop_s: Positive
    """[s] end."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class GustReplay(TimeWindow):
    """A measured gust, linear between its rows, calm before the first and after the last.

    `file` is a CSV file, taken from the scenario's folder. Its first line names the columns, and with them the frame:
    `time_s,north_mps,east_mps,down_mps` or `time_s,u_mps,v_mps,w_mps`. Read once, its numbers are kept as `rows`.
    """

    kind: Literal["replay"]
    """Names this primitive."""
    file: str | None = None
    """Where the rows come from."""
    frame: Frame = "ned"
    """North, east, down (`ned`) or the vehicle's axes (`body`)."""
    rows: Rows
    """(n, 4) time [s] from `start_s` on, rising, and gust [m/s], blowing toward, in `frame`."""

    @model_validator(mode="after")
    def _check_times(self) -> Self:
        check_rising(self.rows)
        return self


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Constant:
    """Steady mean wind: a free vehicle drifts with it; on the test stand it is trimmed out and gives no moment."""

    kind: Literal["constant"]
    """Names this primitive."""
    velocity_mps: Vector | None = None
    """[m/s] N (north, east, down), blowing toward: (5, 0, 0) is a wind from the south."""
    speed_mps: NonNegative | None = None
    """[m/s] of a level wind."""
    from_deg: Finite | None = None
    """[deg] bearing that it comes from: 0 from the north, 90 from the east."""

    @model_validator(mode="after")
    def _check_one_direction(self) -> Self:
        _check_direction("velocity_mps", self.velocity_mps, self.speed_mps, self.from_deg)
        return self

    @property
    def velocity_N(self) -> Vector:
        """[m/s] N, blowing toward."""
        return _wind_vector(self.velocity_mps, self.speed_mps, self.from_deg)


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Shear:
    """Mean wind that grows with the height h as `ln(h / roughness) / ln(20 ft / roughness)`, MIL-F-8785C 3.7.3.2.

    Below 3 ft it is as at 3 ft. On the test stand it is trimmed out and gives no moment.
    """

    kind: Literal["shear"]
    """Names this primitive."""
    velocity_20ft_mps: Vector | None = None
    """[m/s] N at a height of 20 ft, blowing toward."""
    wind_speed_20ft_mps: NonNegative | None = None
    """[m/s] at a height of 20 ft, of a level wind."""
    from_deg: Finite | None = None
    """[deg] bearing that it comes from."""
    roughness_m: Annotated[float, Field(ge=1e-4, le=0.8)] = 0.6096
    """[m] height at which the profile is calm: 2.0 ft, or .15 ft (0.0457 m) in the approach, the specification says."""

    @model_validator(mode="after")
    def _check_one_direction(self) -> Self:
        _check_direction(
            "velocity_20ft_mps", self.velocity_20ft_mps, self.wind_speed_20ft_mps, self.from_deg, "wind_speed_20ft_mps"
        )
        return self

    @property
    def velocity_N(self) -> Vector:
        """[m/s] N at a height of 20 ft, blowing toward."""
        return _wind_vector(self.velocity_20ft_mps, self.wind_speed_20ft_mps, self.from_deg)


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Dryden:
    """Continuous random gusts, low-altitude model (below 1000 ft), all six components.

    The frozen field passes at the mean wind speed at 20 ft, the rule for hover, but not slower than 1 m/s: the model's
    time constants, length over speed, would grow without bound.
    """

    kind: Literal["dryden"]
    """Names this primitive."""
    wind_speed_20ft_mps: Positive | None = None
    """[m/s] mean wind speed at 20 ft."""
    intensity: Literal["light", "moderate", "severe"] | None = None
    """A word for it: 15, 30 or 45 knots at 20 ft, which are 7.7, 15.4 and 23.2 m/s."""
    airspeed_mps: Annotated[float, Field(ge=1.0, allow_inf_nan=False)] | None = None
    """[m/s] speed at which the frozen field passes, where it is not the mean wind's."""
    specification: Literal["MIL-F-8785C", "MIL-HDBK-1797"] = "MIL-F-8785C"
    """Whose lengths and spectra; at low altitude they describe the same gusts in different numbers."""

    @model_validator(mode="after")
    def _check_one_strength(self) -> Self:
        if (self.wind_speed_20ft_mps is None) == (self.intensity is None):
            raise ValueError("give either wind_speed_20ft_mps or intensity")
        return self

    @property
    def wind_speed_20ft(self) -> float:
        """[m/s] mean wind speed at 20 ft."""
        return self.wind_speed_20ft_mps or _INTENSITIES[self.intensity or "light"]

    @property
    def airspeed(self) -> float:
        """[m/s] speed at which the frozen field passes."""
        return self.airspeed_mps or max(self.wind_speed_20ft, 1.0)


Wind = Annotated[
    Constant | GustStep | GustRamp | GustCosine | GustSine | GustSweep | Shear | Dryden | GustReplay,
    Field(discriminator="kind"),
]


def check_rising(rows: Rows) -> None:
    """Refuse rows whose times do not rise.

    Raises
    ------
    ValueError
        If one is not later than that before it.
    """
    for i in range(1, len(rows)):
        if rows[i][0] <= rows[i - 1][0]:
            raise ValueError(f"rows: times must rise, and {rows[i][0]} s follows {rows[i - 1][0]} s")


def _check_direction(
    name: str, vector: Vector | None, speed: float | None, from_deg: float | None, speed_name: str = "speed_mps"
) -> None:
    if (vector is None) == (speed is None) or (speed is None) != (from_deg is None):
        raise ValueError(f"give either {name}, or {speed_name} and from_deg")


def _wind_vector(vector: Vector | None, speed: float | None, from_deg: float | None) -> Vector:
    if vector is not None:
        return vector
    bearing = math.radians(from_deg or 0.0)
    return -(speed or 0.0) * math.cos(bearing), -(speed or 0.0) * math.sin(bearing), 0.0
