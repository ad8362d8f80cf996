"""Field types of the configuration files, and the strict dataclass that their tables are."""

from typing import Annotated, TypeVar, cast, dataclass_transform

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]
PositiveVector = tuple[Positive, Positive, Positive]
_Table = TypeVar("_Table")


@dataclass_transform(frozen_default=True, kw_only_default=True)
def strict_dataclass(kind: type[_Table]) -> type[_Table]:
    """Make a frozen, keyword-only dataclass that validates its fields and rejects unknown keys."""
    strict = dataclass(frozen=True, kw_only=True, config=ConfigDict(extra="forbid"))
    return cast("type[_Table]", strict(kind))
