"""Pack the NamedTuples of floats that kernels compute with into rows of one array, and load them again.

Python hands a compiled function one array in a tenth of the time that it takes to hand over its forty numbers. Several
flights lie side by side in such an array, a row holding the same number of each, so that the compiler finds SIMD in a
loop over them: a flight's numbers are a column.
"""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from firmware_model.numerics.compiled import kernel
from firmware_model.types import Vector

Row = TypeVar("Row", bound=tuple[float, ...])
_INDEX_SOURCE = "    array, width, at = column.array, column.width, row * column.width + column.lane\n"


class Lane(NamedTuple):
    """The numbers of one flight, in an array that flights share."""

    array: NDArray[np.float64]
    """(rows * width,), each number with its own unit."""
    width: int
    """[flights] in the array."""
    lane: int
    """Which of them."""


@kernel
def aligned_zeros(size: int) -> NDArray[np.float64]:
    """Return zeros (size,) that begin at a cache line, as do rows of eight: registers of eight numbers fit in it."""
    room = np.zeros(size + 7)
    start = (-room.ctypes.data // 8) % 8
    return room[start : start + size]


@kernel
def single(array: NDArray[np.float64]) -> Lane:
    """Return the column of a flight that has an array for itself."""
    return Lane(array, 1, 0)


@kernel
def get(column: Lane, row: int) -> float:
    """Return the number in a row."""
    value: float = column.array[row * column.width + column.lane]
    return value


@kernel
def put(column: Lane, row: int, value: float) -> None:
    """Set the number in a row."""
    column.array[row * column.width + column.lane] = value


@kernel
def get_vector(column: Lane, row: int) -> Vector:
    """Return the numbers in three rows."""
    array, width, at = column.array, column.width, row * column.width + column.lane
    return array[at], array[at + width], array[at + 2 * width]


@kernel
def put_vector(column: Lane, row: int, value: Vector) -> None:
    """Set the numbers in three rows."""
    array, width, at = column.array, column.width, row * column.width + column.lane
    array[at], array[at + width], array[at + 2 * width] = value[0], value[1], value[2]


def loader(kind: type[Row]) -> Callable[[Lane, int], Row]:
    """Return the kernel `load(column, row) -> kind` that reads the fields of `kind` from a row on.

    The kernel is written out field by field, because a compiled function can't loop over the fields of a tuple.
    """
    fields = ", ".join(f"array[at + {i} * width]" for i in range(_field_count(kind)))
    kernel_: Callable[[Lane, int], Row] = _define(
        f"def load(column, row):\n{_INDEX_SOURCE}    return kind({fields})", "load", kind
    )
    return kernel_


def storer(kind: type[Row]) -> Callable[[Lane, int, Row], None]:
    """Return the kernel `store(column, row, value)` that writes the fields of `value` from a row on."""
    lines = "\n".join(f"    array[at + {i} * width] = value[{i}]" for i in range(_field_count(kind)))
    kernel_: Callable[[Lane, int, Row], None] = _define(
        f"def store(column, row, value):\n{_INDEX_SOURCE}{lines}", "store", kind
    )
    return kernel_


def offsets(kinds: Iterable[type[tuple[float, ...]]]) -> list[int]:
    """Return the row at which each of `kinds` starts when they are packed in order, and the end."""
    return [0, *np.cumsum([_field_count(kind) for kind in kinds]).tolist()]


def _field_count(kind: Any) -> int:
    return len(kind._fields)


def _define(source: str, name: str, kind: Any) -> Any:
    namespace: dict[str, Any] = {"kind": kind}
    exec(source, namespace)
    return kernel(namespace[name])
