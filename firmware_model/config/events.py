"""What happens to the controller at stated times of a flight, and which modes are set: `[[event]]` tables."""

from typing import Annotated, Literal

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from firmware_model.config.plant_events import PlantEvent
from firmware_model.config.vehicle import NonNegative, Positive

_STRICT = ConfigDict(extra="forbid")


@dataclass(frozen=True, slots=True, kw_only=True, config=_STRICT)
class ModeChange:
    """Another flight mode is asked for, as a ground station would."""

    kind: Literal["mode"]
    """Names this event."""
    at_s: NonNegative
    """[s] time of the sample before which it happens."""
    mode: Literal["manual", "altctl", "posctl", "takeoff", "hold", "return", "land", "offboard", "stabilized"]
    """PX4's name of the mode; OFFBOARD is refused without living set-points."""


@dataclass(frozen=True, slots=True, kw_only=True, config=_STRICT)
class ControllerHang:
    """The controller hears nothing and says nothing for a while, then goes on from the state that it has."""

    kind: Literal["controller_hung"]
    """Names this event."""
    at_s: NonNegative
    """[s] time of the first sample that it does not hear."""
    for_s: Positive
    """[s] how long."""


@dataclass(frozen=True, slots=True, kw_only=True, config=_STRICT)
class ControllerKill:
    """The controller's process ends; another one, which knows nothing of the first, may take its place."""

    kind: Literal["controller_killed"]
    """Names this event."""
    at_s: NonNegative
    """[s] time of the first sample that it does not hear."""
    recovers_after_s: Positive | None = None
    """[s] from then on, until the next one joins; never by default."""


Event = Annotated[ModeChange | ControllerHang | ControllerKill | PlantEvent, Field(discriminator="kind")]
