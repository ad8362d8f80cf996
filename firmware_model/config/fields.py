"""Field types of the configuration files, and the strict dataclasses that their tables are."""

from collections.abc import Callable
from typing import Annotated, Literal, Self, TypeVar, cast, dataclass_transform

from pydantic import BeforeValidator, ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass


def _refuse_truth(value: object) -> object:
    """Refuse true and false, which would count as 1 and 0."""
    if isinstance(value, bool):
        raise ValueError("must be a number, not true or false")
    return value


NOT_TRUTH = BeforeValidator(_refuse_truth)
"""Stands behind the bounds of a number: before them, schemas would not tell these."""
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False), NOT_TRUTH]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False), NOT_TRUTH]
Finite = Annotated[float, Field(allow_inf_nan=False), NOT_TRUTH]
Fraction = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False), NOT_TRUTH]
Time = Annotated[float, Field(ge=0.0, le=86_400.0), NOT_TRUTH]
Duration = Annotated[float, Field(gt=0.0, le=86_400.0), NOT_TRUTH]
Vector = tuple[Finite, Finite, Finite]
PositiveVector = tuple[Positive, Positive, Positive]
_Table = TypeVar("_Table")


@dataclass_transform(frozen_default=True, kw_only_default=True)
def strict_dataclass(kind: type[_Table]) -> type[_Table]:
    """Make a frozen, keyword-only dataclass that validates its fields and rejects unknown keys."""
    strict = dataclass(frozen=True, kw_only=True, config=ConfigDict(extra="forbid", defer_build=True))
    return cast("type[_Table]", strict(kind))


@dataclass_transform(frozen_default=True, kw_only_default=True)
def tagged_dataclass(kind: str) -> Callable[[type[_Table]], type[_Table]]:
    """Make a `strict_dataclass` of a `Tagged` table, one of a union that the file's key `kind` selects from."""

    def make(table: type[_Table]) -> type[_Table]:
        table.__annotations__ = {"kind": Literal[kind], **table.__annotations__}
        return strict_dataclass(table)

    return make


@strict_dataclass
class Tagged:
    """Table with a name that tells it from the others of its list."""

    kind: str
    """Name of this kind of table."""


@strict_dataclass
class TimeWindow:
    """Time window in which a table acts."""

    start_s: Time = 0.0
    """[s] start."""
    stop_s: Positive | None = None
    """[s] end; to the end of the flight by default."""

    @model_validator(mode="after")
    def _check_interval(self) -> Self:
        if self.stop_s is not None and self.stop_s <= self.start_s:
            raise ValueError("stop_s must be later than start_s")
        return self

    def span(self, duration_s: float) -> tuple[float, float]:
        """Return start and end [s] of what it does in a flight of `duration_s` [s]."""
        return self.start_s, duration_s if self.stop_s is None else min(self.stop_s, duration_s)
