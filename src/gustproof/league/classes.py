"""Price classes: entrants compete with those that are as robust and as quiet as they are, by measurement."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

TOLERANCE = 0.03
"""[-] share by which a measured figure may exceed a bound: the accuracy of the experiment."""


class PriceClass(NamedTuple):
    """Bounds of a class, kept on every vehicle."""

    name: str
    """Name."""
    Ms: float
    """[-] largest sensitivity peak of the worst axis."""
    gain_margin: float
    """[-] least factor on the loop gain that destabilises."""
    delay_margin: float
    """[s] least additional delay that destabilises."""
    slew_share: float
    """[-] largest torque slew, over `default_slew` of the vehicle."""


CLASSES = (
    PriceClass("robust", 1.4, 3.0, 0.012, 1.1),
    PriceClass("usual", 1.7, 2.3, 0.008, 1.7),
    PriceClass("sharp", 2.0, 1.9, 0.004, 3.0),
    PriceClass("open", math.inf, 0.0, 0.0, math.inf),
)
"""Classes from the most robust; all but the last have bounds."""


class Charge(NamedTuple):
    """Measured price of an entrant on a vehicle."""

    Ms: float
    """[-] sensitivity peak of the worst axis; infinite if none could be measured."""
    gain_margin: float
    """[-] least factor above 1 that destabilises."""
    delay_margin: float
    """[s] least additional delay that destabilises."""
    slew: float
    """[N*m/s] rms torque slew in the turbulence of the tuning."""
    slew_share: float
    """[-] slew over `default_slew` of the vehicle."""
    refused: str
    """Reason why no price could be measured; empty if it was."""

    def to_dict(self) -> dict[str, Any]:
        """Return the price as JSON values; a number that is not finite is `None`."""
        return {
            name: value if not isinstance(value, float) or math.isfinite(value) else None
            for name, value in self._asdict().items()
        }


def read_charge(result: dict[str, Any], default_slew: float) -> Charge:
    """Return the price in the result of a `Weigh`."""
    if "price" not in result:
        return Charge(math.inf, 1.0, 0.0, math.inf, math.inf, result["refused"])
    price = result["price"]
    gain, delay = (math.inf if price[name] is None else price[name] for name in ("gain_margin", "delay_margin_s"))
    return Charge(price["Ms"], gain, delay, price["slew"], price["slew"] / default_slew, "")


def classify(charges: Sequence[Charge]) -> PriceClass:
    """Return the first class whose bounds are kept on all vehicles."""
    return next(each for each in CLASSES if all(_keeps(charge, each) for charge in charges))


def _keeps(charge: Charge, bounds: PriceClass) -> bool:
    above, below = 1.0 + TOLERANCE, 1.0 - TOLERANCE
    return (
        charge.Ms <= above * bounds.Ms
        and charge.gain_margin >= below * bounds.gain_margin
        and charge.delay_margin >= below * bounds.delay_margin
        and charge.slew_share <= above * bounds.slew_share
    )
