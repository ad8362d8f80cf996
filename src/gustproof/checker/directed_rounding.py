"""Figures of a statement: what is proved is printed rounded up, what is assumed rounded down.

Part of the check: standard library only. A double is meant as its shortest decimal, which JSON holds and which reads
back as the same double. So a printed bound, given to the check again, is never below the proved one. A printed
assumption is never above the one that the proof rests on.
"""

import math
from collections.abc import Iterable
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from fractions import Fraction

_DIGITS = 6
"""Significant digits of a printed figure."""
_EXACT = Context(prec=1100)
"""Digits enough for every double, with three decimals."""


def float_up(value: Fraction | float) -> float:
    """Return the least double that is not below `value`."""
    nearest = float(value)
    return nearest if nearest >= value else math.nextafter(nearest, math.inf)


def float_down(value: Fraction | float) -> float:
    """Return the largest double that is not above `value`."""
    nearest = float(value)
    return nearest if nearest <= value else math.nextafter(nearest, -math.inf)


def print_up(value: Fraction | float, digits: int = _DIGITS) -> str:
    """Return a bound or a risk in `digits`, not below `value`."""
    return _print(Context(prec=digits, rounding=ROUND_CEILING).plus(_decimal(float_up(value))))


def print_down(value: Fraction | float, digits: int = _DIGITS) -> str:
    """Return an assumption or a lower bound in `digits`, not above `value`."""
    return _print(Context(prec=digits, rounding=ROUND_FLOOR).plus(_decimal(float_down(value))))


def percent_down(share: Fraction | float, digits: int = _DIGITS) -> str:
    """Return a share that is assumed, in percent in `digits`, not above `share`."""
    return _print(Context(prec=digits, rounding=ROUND_FLOOR).multiply(_decimal(float_down(share)), Decimal(100)))


def list_up(values: Iterable[Fraction | float]) -> str:
    """Return bounds to three decimals, none below its value."""
    unit = Decimal("0.001")
    return ", ".join(_print(_decimal(float_up(value)).quantize(unit, ROUND_CEILING, _EXACT)) for value in values)


def list_down(values: Iterable[Fraction | float]) -> str:
    """Return assumptions, none above its value."""
    return ", ".join(map(print_down, values))


def _decimal(value: float) -> Decimal:
    return Decimal(repr(value))


def _print(value: Decimal) -> str:
    """Return a decimal without trailing zeros; very large and very small ones with an exponent."""
    if not value:
        return "0"
    short = value.normalize(_EXACT)
    return f"{short:f}" if -5 < short.adjusted() < 16 else f"{short:e}"
