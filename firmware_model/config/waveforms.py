"""Tables of wind and of direct moments, `[[wind]]` and `[[moment]]`. Each is a primitive by its `kind`; all add up.

A wind table gives the velocity of the air. Its vector points where the wind blows to. It gives `amplitude_mps` in its
`frame`, or `speed_mps` and `from_deg`, the bearing that a level wind comes from, as in meteorology. Mean wind
(`constant`, `shear`) carries a free vehicle along and is trimmed out on the test stand. All other winds are gusts,
which push on the vehicle there too.

A waveform (`Step`, `Ramp`, ...) gives the course in time; `Gust` and `DirectMoment` give axis and strength.
"""

import math
from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import FailFast, Field, model_validator

from firmware_model.config.fields import (
    NOT_TRUTH,
    Finite,
    NonNegative,
    Positive,
    Tagged,
    TimeWindow,
    Vector,
    strict_dataclass,
    tagged_dataclass,
)
from firmware_model.exact import sin_cos

KNOT = 0.514444
"""[m/s] 1852 m an hour."""
Frame = Literal["body", "ned"]
Rate = Annotated[float, Field(gt=0.0, le=3200.0), NOT_TRUTH]
MAX_ROWS = 150_000
"""Rows of a `replay`: ten minutes at 250 Hz."""
Rows = Annotated[
    tuple[tuple[Finite, Finite, Finite, Finite], ...], FailFast(), Field(min_length=2, max_length=MAX_ROWS)
]
DRYDEN_CEILING_M = 304.8
"""[m] 1000 ft, the end of the low-altitude model (MIL-F-8785C, 3.7.3.4)."""
_INTENSITIES = {"light": 15.0 * KNOT, "moderate": 30.0 * KNOT, "severe": 45.0 * KNOT}  # MIL-F-8785C, figure 9: W20


@tagged_dataclass("step")
class Step(Tagged):
    """Waveform at full amplitude from its start."""


@tagged_dataclass("ramp")
class Ramp(Tagged, TimeWindow):
    """Waveform that grows linearly and then stays at full amplitude."""

    rise_s: Positive
    """[s] from zero to the peak."""

    def span(self, duration_s: float) -> tuple[float, float]:
        """Return start and end [s] of the growth, or of all if it stops."""
        start, end = TimeWindow.span(self, duration_s)
        return start, end if self.stop_s is not None else min(end, start + self.rise_s)


@tagged_dataclass("one_minus_cosine")
class OneMinusCosine(Tagged, TimeWindow):
    """Waveform `amplitude / 2 * (1 - cos(2 pi (t - start) / length))`, zero outside its length."""

    length_s: Positive
    """[s] from zero to zero."""

    def span(self, duration_s: float) -> tuple[float, float]:
        """Return start and end [s]."""
        start, end = TimeWindow.span(self, duration_s)
        return start, min(end, start + self.length_s)


@tagged_dataclass("sine")
class Sine(Tagged):
    """Waveform `amplitude * sin(rate * (t - start) + phase)`."""

    rate_rad_s: Rate
    """[rad/s] angular frequency."""
    phase_rad: Finite = 0.0
    """[rad] at the start."""


@tagged_dataclass("square")
class Square(Tagged):
    """Waveform always at full amplitude, `amplitude * sign(sin(rate * (t - start) + phase))`: bang-bang."""

    rate_rad_s: Rate
    """[rad/s] angular frequency; the sign changes twice a period."""
    phase_rad: Finite = 0.0
    """[rad] at the start."""


@tagged_dataclass("sine_sweep")
class Sweep(Tagged):
    """Sine that starts at sin(0); its angular frequency changes linearly from start to `stop_s`."""

    rate_from_rad_s: Rate
    """[rad/s] angular frequency at the start."""
    rate_to_rad_s: Rate
    """[rad/s] angular frequency at the end."""
    stop_s: Positive
    """[s] end."""


@tagged_dataclass("replay")
class Replay(Tagged, TimeWindow):
    """Measured data, linear between its rows, zero before the first and after the last.

    `file` is a CSV file, relative to the scenario's folder. Its first line names the columns and thereby the frame. A
    gust has `time_s,north_mps,east_mps,down_mps` or `time_s,u_mps,v_mps,w_mps`. A moment has
    `time_s,north_nm,east_nm,down_nm` or `time_s,L_nm,M_nm,N_nm`. The file is read once; its numbers are kept as `rows`.
    """

    file: str | None = None
    """File that the rows come from."""
    frame: Frame
    """North, east, down (`ned`) or the vehicle's axes (`body`)."""
    rows: Rows
    """(n, 4) time [s] from `start_s` on, rising, and gust [m/s], blowing toward, or moment [N*m], in `frame`."""

    @model_validator(mode="after")
    def _check_times(self) -> Self:
        for (before, *_), (time, *_) in pairwise(self.rows):
            if time <= before:
                raise ValueError(f"rows: times must rise, and {time} s follows {before} s")
        return self

    def span(self, duration_s: float) -> tuple[float, float]:
        """Return start and end [s]."""
        start, end = TimeWindow.span(self, duration_s)
        return start, min(end, start + self.rows[-1][0])


@strict_dataclass
class Gust(TimeWindow):
    """Direction and strength of a gust, and the time in which it acts."""

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
        """True if the vector is in N, not in B."""
        return self.frame == "ned" or self.from_deg is not None


@strict_dataclass
class GustStep(Step, Gust):
    """Gust at full strength at once."""


@strict_dataclass
class GustRamp(Ramp, Gust):
    """Gust front."""


@strict_dataclass
class GustCosine(OneMinusCosine, Gust):
    """Discrete gust."""


@strict_dataclass
class GustSine(Sine, Gust):
    """Gust at one frequency."""


@strict_dataclass
class GustSweep(Sweep, Gust):
    """Gust of changing frequency."""


@strict_dataclass
class GustReplay(Replay):
    """Measured gust."""

    frame: Frame = "ned"
    """North, east, down (`ned`) or the vehicle's axes (`body`)."""


@strict_dataclass
class DirectMoment(TimeWindow):
    """Axis and strength of a moment, and the time in which it acts."""

    amplitude_nm: Vector
    """[N*m] at its peak, in `frame`."""
    frame: Frame = "body"
    """The vehicle's axes (`body`), or north, east, down (`ned`)."""

    @property
    def vector(self) -> Vector:
        """[N*m] at its peak, B or N."""
        return self.amplitude_nm

    @property
    def is_earth_frame(self) -> bool:
        """True if the vector is in N, not in B."""
        return self.frame == "ned"


@strict_dataclass
class MomentStep(Step, DirectMoment):
    """Moment at full strength at once."""


@strict_dataclass
class MomentRamp(Ramp, DirectMoment):
    """Moment that grows and then stays."""


@strict_dataclass
class MomentCosine(OneMinusCosine, DirectMoment):
    """Discrete moment."""


@strict_dataclass
class MomentSine(Sine, DirectMoment):
    """Moment at one frequency."""


@strict_dataclass
class MomentSquare(Square, DirectMoment):
    """Bang-bang moment."""


@strict_dataclass
class MomentSweep(Sweep, DirectMoment):
    """Moment of changing frequency."""


@strict_dataclass
class MomentReplay(Replay):
    """Measured moment."""

    frame: Frame = "body"
    """The vehicle's axes (`body`), or north, east, down (`ned`)."""


Moment = Annotated[
    MomentStep | MomentRamp | MomentCosine | MomentSine | MomentSquare | MomentSweep | MomentReplay,
    Field(discriminator="kind"),
]


@tagged_dataclass("constant")
class Constant(Tagged):
    """Steady mean wind. A free vehicle drifts with it; on the test stand it is trimmed out and gives no moment."""

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


@tagged_dataclass("shear")
class Shear(Tagged):
    """Mean wind that grows with the height h as `ln(h / roughness) / ln(20 ft / roughness)`, MIL-F-8785C 3.7.3.2.

    Below 3 ft it is as at 3 ft. On the test stand it is trimmed out and gives no moment.
    """

    velocity_20ft_mps: Vector | None = None
    """[m/s] N at a height of 20 ft, blowing toward."""
    wind_speed_20ft_mps: NonNegative | None = None
    """[m/s] at a height of 20 ft, of a level wind."""
    from_deg: Finite | None = None
    """[deg] bearing that it comes from."""
    roughness_m: Annotated[float, Field(ge=1e-4, le=0.8), NOT_TRUTH] = 0.6096
    """[m] height at which the profile is calm. The specification: 2.0 ft, or .15 ft (0.0457 m) in the approach."""

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


@strict_dataclass
class RandomGusts(Tagged):
    """Continuous random gusts, low-altitude model (below 1000 ft), all six components."""

    wind_speed_20ft_mps: Positive | None = None
    """[m/s] mean wind speed at 20 ft."""
    intensity: Literal["light", "moderate", "severe"] | None = None
    """The wind speed by name: 15, 30 or 45 knots at 20 ft, that is 7.7, 15.4 or 23.2 m/s."""
    airspeed_mps: Annotated[float, Field(ge=1.0, allow_inf_nan=False), NOT_TRUTH] | None = None
    """[m/s] speed at which the frozen field passes, if it is not that of the mean wind."""
    specification: Literal["MIL-F-8785C", "MIL-HDBK-1797"] = "MIL-F-8785C"
    """Source of lengths and spectra. At low altitude both describe the same gusts in different numbers."""

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


@tagged_dataclass("dryden")
class Dryden(RandomGusts):
    """Continuous random gusts, low-altitude model (below 1000 ft), all six components.

    The frozen field passes at the mean wind speed at 20 ft, the rule for hover, but at 1 m/s at least. Below it the
    model's time constants, length over speed, would grow without bound.
    """


@tagged_dataclass("von_karman")
class VonKarman(RandomGusts):
    """Continuous random gusts as of `dryden`, with von Karman's spectra: more above the break frequency.

    Filters of order five have these spectra within 1.4 % up to 740 / length [rad/m]. The standard prefers them where
    structures count. Proofs are of `dryden` alone, and say so.
    """


Wind = Annotated[
    Constant | GustStep | GustRamp | GustCosine | GustSine | GustSweep | Shear | Dryden | VonKarman | GustReplay,
    Field(discriminator="kind"),
]


def _check_direction(
    name: str, vector: Vector | None, speed: float | None, from_deg: float | None, speed_name: str = "speed_mps"
) -> None:
    if (vector is None) == (speed is None) or (speed is None) != (from_deg is None):
        raise ValueError(f"give either {name}, or {speed_name} and from_deg")


def _wind_vector(vector: Vector | None, speed: float | None, from_deg: float | None) -> Vector:
    if vector is not None:
        return vector
    sine, cosine = sin_cos(math.radians(from_deg or 0.0))
    return -(speed or 0.0) * cosine, -(speed or 0.0) * sine, 0.0
