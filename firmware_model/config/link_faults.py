"""Faults of the link between vehicle and controller: the `[[link]]` tables of a scenario."""

from typing import Annotated, Literal, Self

from pydantic import ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass

from firmware_model.config.vehicle import NonNegative, Positive

_STRICT = ConfigDict(extra="forbid")

Probability = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)]


@dataclass(frozen=True, slots=True, kw_only=True, config=_STRICT)
class _LinkFault:
    direction: Literal["to_controller", "to_vehicle"]
    """Samples travel to the controller, set-points to the vehicle."""
    start_s: NonNegative = 0.0
    """[s] begin."""
    stop_s: Positive | None = None
    """[s] end; to the end of the flight by default."""

    @model_validator(mode="after")
    def _check_interval(self) -> Self:
        if self.stop_s is not None and self.stop_s <= self.start_s:
            raise ValueError("stop_s must be later than start_s")
        return self


@dataclass(frozen=True, slots=True, kw_only=True, config=_STRICT)
class Delay(_LinkFault):
    """All arrive later by the same time."""

    kind: Literal["delay"]
    """Names this fault."""
    delay_s: Positive
    """[s] from sending to arrival."""


@dataclass(frozen=True, slots=True, kw_only=True, config=_STRICT)
class Jitter(_LinkFault):
    """Each arrives later by a time of its own, uniform in [0, most]; none overtakes another."""

    kind: Literal["jitter"]
    """Names this fault."""
    most_s: Positive
    """[s] the largest."""


@dataclass(frozen=True, slots=True, kw_only=True, config=_STRICT)
class Loss(_LinkFault):
    """Each is lost with the same probability, whatever became of the others."""

    kind: Literal["loss"]
    """Names this fault."""
    probability: Probability
    """[-] of a loss."""


@dataclass(frozen=True, slots=True, kw_only=True, config=_STRICT)
class BurstLoss(_LinkFault):
    """Loss in bursts: a chain of two states that may change with each datagram, and begins in the good one.

    The share of the bad state is `to_bad / (to_bad + to_good)`, its mean length `1 / to_good` datagrams.

    References
    ----------
    E. N. Gilbert, Capacity of a burst-noise channel, Bell System Technical Journal 39, 1960.
    E. O. Elliott, Estimates of error rates for codes on burst-noise channels, Bell System Technical Journal 42, 1963.
    """

    kind: Literal["burst_loss"]
    """Names this fault."""
    to_bad: Probability
    """[-] probability that a good state turns bad, at each datagram."""
    to_good: Probability
    """[-] probability that a bad state turns good, at each datagram."""
    loss_in_bad: Probability = 1.0
    """[-] probability of a loss in the bad state."""
    loss_in_good: Probability = 0.0
    """[-] probability of a loss in the good state."""


@dataclass(frozen=True, slots=True, kw_only=True, config=_STRICT)
class Duplication(_LinkFault):
    """Some arrive twice, each copy with a jitter of its own."""

    kind: Literal["duplication"]
    """Names this fault."""
    probability: Probability
    """[-] of a second copy."""


@dataclass(frozen=True, slots=True, kw_only=True, config=_STRICT)
class Reordering(_LinkFault):
    """Some are held back, so that others overtake them."""

    kind: Literal["reordering"]
    """Names this fault."""
    probability: Probability
    """[-] of being held back."""
    by_s: Positive
    """[s] for how long."""


@dataclass(frozen=True, slots=True, kw_only=True, config=_STRICT)
class Bandwidth(_LinkFault):
    """One is sent after the other, as fast as the rate allows; of those that must wait, too many are lost.

    A sample is 73 bytes, torques are 55, rates and attitudes 51: at 250 Hz that is 146, 110 and 102 kbit/s.
    """

    kind: Literal["bandwidth"]
    """Names this fault."""
    rate_bit_s: Positive
    """[bit/s] of MAVLink frames."""
    queue: Annotated[int, Field(ge=0, le=10_000)] = 10
    """Datagrams that may wait while one is being sent."""


LinkFault = Annotated[
    Delay | Jitter | Loss | BurstLoss | Duplication | Reordering | Bandwidth, Field(discriminator="kind")
]
AnyFault = Delay | Jitter | Loss | BurstLoss | Duplication | Reordering | Bandwidth
