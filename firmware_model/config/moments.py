"""The tables of direct moments, `[[moment]]`: each a primitive by its `kind`, all added up."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from firmware_model.config.vehicle import Finite, Positive, Vector
from firmware_model.config.wind import STRICT, Frame, Rate, Rows, TimeWindow, check_rising


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class DirectMoment(TimeWindow):
    """A moment's axis and strength, and when it acts."""

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
        """Whether the vector is in N, and not in B."""
        return self.frame == "ned"


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class MomentStep(DirectMoment):
    """Moment that is there at once."""

    kind: Literal["step"]
    """Names this primitive."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class MomentRamp(DirectMoment):
    """Moment that grows linearly and then stays."""

    kind: Literal["ramp"]
    """Names this primitive."""
    rise_s: Positive
    """[s] from nothing to the peak."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class MomentCosine(DirectMoment):
    """Moment `amplitude / 2 * (1 - cos(2 pi (t - start) / length))`, zero outside its length."""

    kind: Literal["one_minus_cosine"]
    """Names this primitive."""
    length_s: Positive
    """[s] from nothing to nothing."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class MomentSine(DirectMoment):
    """Moment `amplitude * sin(rate * (t - start) + phase)`."""

    kind: Literal["sine"]
    """Names this primitive."""
    rate_rad_s: Rate
    """[rad/s] angular frequency."""
    phase_rad: Finite = 0.0
    """[rad] at the start."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class MomentSquare(DirectMoment):
    """Moment of full amplitude all the time, `amplitude * sign(sin(rate * (t - start) + phase))`: bang-bang."""

    kind: Literal["square"]
    """Names this primitive."""
    rate_rad_s: Rate
    """[rad/s] angular frequency; the sign changes twice a period."""
    phase_rad: Finite = 0.0
    """[rad] at the start."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class MomentSweep(DirectMoment):
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
class MomentReplay(TimeWindow):
    """A measured moment, linear between its rows, nothing before the first and after the last.

    `file` is a CSV file, taken from the scenario's folder. Its first line names the columns, and with them the frame:
    `time_s,L_nm,M_nm,N_nm` or `time_s,north_nm,east_nm,down_nm`. Read once, its numbers are kept as `rows`.
    """

    kind: Literal["replay"]
    """Names this primitive."""
    file: str | None = None
    """Where the rows come from."""
    frame: Frame = "body"
    """The vehicle's axes (`body`), or north, east, down (`ned`)."""
    rows: Rows
    """(n, 4) time [s] from `start_s` on, rising, and moment [N*m] in `frame`."""

    @model_validator(mode="after")
    def _check_times(self) -> Self:
        check_rising(self.rows)
        return self


Moment = Annotated[
    MomentStep | MomentRamp | MomentCosine | MomentSine | MomentSquare | MomentSweep | MomentReplay,
    Field(discriminator="kind"),
]
