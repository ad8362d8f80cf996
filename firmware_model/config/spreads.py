"""Uncertain numbers of a file: `{ nominal = 0.05, low = 0.035, high = 0.065 }` in place of the number.

A normalised `delta` in [-1, 1] selects the value: low at -1, nominal at 0, high at 1. LFT and campaign use this delta.
"""

from collections.abc import Iterator, Mapping
from typing import Any, Self

from pydantic import model_validator

from firmware_model.config.fields import Finite, strict_dataclass
from firmware_model.config.files import validate


@strict_dataclass
class Spread:
    """Uncertain number."""

    nominal: Finite
    """[as the number] value at delta = 0."""
    low: Finite
    """[as the number] least value."""
    high: Finite
    """[as the number] largest value."""

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if not self.low < self.nominal < self.high:
            raise ValueError(f"needs low < nominal < high, got {self.low}, {self.nominal}, {self.high}")
        near, far = sorted((self.nominal - self.low, self.high - self.nominal))
        if near <= 1e-9 * far:
            raise ValueError(f"low or high is {near:g} from nominal, the other {far:g}: must be nearer to each other")
        return self

    def value(self, delta: float) -> float:
        """Return the number at the normalised `delta`: `nominal + b delta / (1 + c delta)`, linear about the middle."""
        up, down = self.high - self.nominal, self.nominal - self.low
        b, c = 2.0 * up * down / (up + down), (down - up) / (up + down)
        return self.nominal + b * delta / (1.0 + c * delta)


def take_nominal(document: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Return a file's document with each spread replaced by its nominal number.

    Raises
    ------
    ConfigError
        If a key or value of a spread is not allowed; the error names `source`.
    """
    return {key: _take_nominal(value, f"{source}: {key}") for key, value in document.items()}


def _take_nominal(value: Any, source: str) -> Any:
    if isinstance(value, dict):
        if "nominal" in value:
            return validate(Spread, value, source).nominal
        return {key: _take_nominal(item, f"{source}.{key}") for key, item in value.items()}
    if isinstance(value, list):
        return [_take_nominal(item, f"{source}.{number}") for number, item in enumerate(value)]
    return value


def iter_spreads(document: Any, name: str = "") -> Iterator[tuple[str, Spread]]:
    """Yield name and spread of each uncertain number of a validated document.

    Names join keys by dots; components of a vector are x, y, z.
    """
    if isinstance(document, dict) and "nominal" in document:
        yield name, Spread(**document)
    elif isinstance(document, dict | list):
        for key, item in document.items() if isinstance(document, dict) else _components(document):
            yield from iter_spreads(item, f"{name}.{key}" if name else str(key))


def substitute_spreads(document: Any, values: Mapping[str, float], name: str = "") -> Any:
    """Return a document with its spreads replaced by `values`, given by name."""
    if name in values:
        return values[name]
    if isinstance(document, dict):
        return {
            key: substitute_spreads(item, values, f"{name}.{key}" if name else str(key))
            for key, item in document.items()
        }
    if isinstance(document, list):
        return [substitute_spreads(item, values, f"{name}.{key}") for key, item in _components(document)]
    return document


def _components(items: list[Any]) -> Iterator[tuple[str, Any]]:
    yield from zip("xyz" if len(items) == 3 else map(str, range(len(items))), items, strict=True)
