"""Faults of the link between vehicle and controller: the `[[link]]` tables of a scenario."""

from typing import Annotated, Literal

from pydantic import Field

from firmware_model.config.fields import (
    NOT_TRUTH,
    Fraction,
    Positive,
    Tagged,
    TimeWindow,
    strict_dataclass,
    tagged_dataclass,
)


@strict_dataclass
class _LinkFault(Tagged, TimeWindow):
    """Direction of a link fault, and the time in which it acts."""

    direction: Literal["to_controller", "to_vehicle"]
    """Samples travel to the controller, set-points to the vehicle."""


@tagged_dataclass("delay")
class LinkDelay(_LinkFault):
    """Constant delay of every datagram."""

    delay_s: Positive
    """[s] from sending to arrival."""


@tagged_dataclass("jitter")
class Jitter(_LinkFault):
    """Random delay of each datagram, uniform in [0, most]; none overtakes another."""

    most_s: Positive
    """[s] largest delay."""


@tagged_dataclass("loss")
class Loss(_LinkFault):
    """Independent loss of each datagram with the same probability."""

    probability: Fraction
    """[-] of a loss."""


@tagged_dataclass("burst_loss")
class BurstLoss(_LinkFault):
    """Loss in bursts: a two-state Markov chain that starts in the good state and may change at each datagram.

    The share of the bad state is `to_bad / (to_bad + to_good)`, its mean length `1 / to_good` datagrams.

    References
    ----------
    E. N. Gilbert, Capacity of a burst-noise channel, Bell System Technical Journal 39, 1960.
    E. O. Elliott, Estimates of error rates for codes on burst-noise channels, Bell System Technical Journal 42, 1963.
    """

    to_bad: Fraction
    """[-] probability that a good state turns bad, at each datagram."""
    to_good: Fraction
    """[-] probability that a bad state turns good, at each datagram."""
    loss_in_bad: Fraction = 1.0
    """[-] probability of a loss in the bad state."""
    loss_in_good: Fraction = 0.0
    """[-] probability of a loss in the good state."""


@tagged_dataclass("duplication")
class Duplication(_LinkFault):
    """Duplication of some datagrams; each copy has its own jitter."""

    probability: Fraction
    """[-] of a second copy."""


@tagged_dataclass("reordering")
class Reordering(_LinkFault):
    """Extra delay of some datagrams, so that later ones overtake them."""

    probability: Fraction
    """[-] of the extra delay."""
    by_s: Positive
    """[s] extra delay."""


@tagged_dataclass("bandwidth")
class Bandwidth(_LinkFault):
    """Limited bit rate: datagrams queue for transmission, and those beyond the queue are lost.

    A sample takes 73 bytes, torques 55, rates and attitudes 51. At 250 Hz that is 146, 110 and 102 kbit/s.
    """

    rate_bit_s: Positive
    """[bit/s] of MAVLink frames."""
    queue: Annotated[int, Field(ge=0, le=10_000), NOT_TRUTH] = 10
    """Datagrams that may wait while one is in transmission."""


AnyFault = LinkDelay | Jitter | Loss | BurstLoss | Duplication | Reordering | Bandwidth
LinkFault = Annotated[AnyFault, Field(discriminator="kind")]
