"""Pack NamedTuples of floats into rows of one array, side by side for several flights, and load them in kernels.

Python hands one array to a compiled function in a tenth of the time that forty numbers take. Several flights share an
array, one per lane: each row holds the same number of every flight, so that the compiler finds SIMD in a loop over
lanes.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from numba.core import cgutils, types
from numba.core.types.containers import NamedUniTuple
from numba.extending import intrinsic, overload
from numpy.typing import NDArray

from firmware_model.numerics.compiled import INLINED, kernel
from firmware_model.types import Vector

Row = TypeVar("Row", bound=tuple[float, ...])


class Lane(NamedTuple):
    """The numbers of one flight, in an array that flights share."""

    array: NDArray[np.float64]
    """(rows * width,), each number with its own unit."""
    width: int
    """[flights] in the array."""
    number: int
    """Number of this flight's lane in the array, from 0."""


@kernel
def aligned_zeros(size: int) -> NDArray[np.float64]:
    """Return zeros (size,) that begin at a cache line, as does each row of eight: an eight-number register fits one."""
    room = np.zeros(size + 7)
    start = (-room.ctypes.data // 8) % 8
    return room[start : start + size]


@kernel
def single(array: NDArray[np.float64]) -> Lane:
    """Return the lane of a flight that has an array for itself."""
    return Lane(array, 1, 0)


@kernel
def get(lane: Lane, row: int) -> float:
    """Return the number in a row."""
    value: float = lane.array[row * lane.width + lane.number]
    return value


@kernel
def put(lane: Lane, row: int, value: float) -> None:
    """Set the number in a row."""
    lane.array[row * lane.width + lane.number] = value


@kernel
def get_vector(lane: Lane, row: int) -> Vector:
    """Return the numbers in three rows."""
    array, width, at = lane.array, lane.width, row * lane.width + lane.number
    return array[at], array[at + width], array[at + 2 * width]


@kernel
def put_vector(lane: Lane, row: int, value: Vector) -> None:
    """Set the numbers in three rows."""
    array, width, at = lane.array, lane.width, row * lane.width + lane.number
    array[at], array[at + width], array[at + 2 * width] = value[0], value[1], value[2]


def loader(kind: type[Row]) -> Callable[[Lane, int], Row]:
    """Return the kernel `load(lane, row) -> kind` that reads the fields of `kind`, the first of them from `row`."""
    count, gather, make = _field_count(kind), intrinsic(_make_gather(kind)), cast(Any, kind)._make

    def load(lane: Lane, row: int) -> Row:
        at = row * lane.width + lane.number
        loaded: Row = make(lane.array[at : at + count * lane.width : lane.width])
        return loaded

    def overload_load(_lane: Any, _row: Any) -> Any:
        return lambda lane, row: gather(lane.array, row * lane.width + lane.number, lane.width)

    overload(load, **INLINED)(overload_load)
    return load


def storer(kind: type[Row]) -> Callable[[Lane, int, Row], None]:
    """Return the kernel `store(lane, row, value)` that writes the fields of `value`, the first of them to `row`."""
    count, scatter = _field_count(kind), intrinsic(_scatter)

    def store(lane: Lane, row: int, value: Row) -> None:
        at = row * lane.width + lane.number
        lane.array[at : at + count * lane.width : lane.width] = value

    def overload_store(_lane: Any, _row: Any, _value: Any) -> Any:
        return lambda lane, row, value: scatter(lane.array, row * lane.width + lane.number, lane.width, value)

    overload(store, **INLINED)(overload_store)
    return store


def offsets(kinds: Iterable[type[tuple[float, ...]]]) -> list[int]:
    """Return the row at which each of `kinds` starts when they are packed in order, and the end."""
    return [0, *np.cumsum([_field_count(kind) for kind in kinds]).tolist()]


def _field_count(kind: Any) -> int:
    return len(kind._fields)


# A compiled function can't loop over the fields of a tuple, so these two write out LLVM instructions field by field.
def _make_gather(kind: Any) -> Callable[..., Any]:
    """Return the typing of the intrinsic `gather(array, at, width) -> kind`."""
    count = _field_count(kind)

    def gather(_: Any, array: Any, at: Any, width: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            pointers = _field_pointers(context, builder, array, arguments, count)
            return context.make_tuple(builder, signature.return_type, [builder.load(pointer) for pointer in pointers])

        return NamedUniTuple(types.float64, count, kind)(array, types.intp, types.intp), generate

    return gather


def _scatter(_: Any, array: Any, at: Any, width: Any, row: Any) -> Any:
    """Return the typing of the intrinsic `scatter(array, at, width, row)`."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        *position, values = arguments
        for i, pointer in enumerate(_field_pointers(context, builder, array, position, len(row))):
            value = builder.extract_value(values, i)
            builder.store(context.cast(builder, value, row.types[i], types.float64), pointer)
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, row), generate


def _field_pointers(context: Any, builder: Any, array: Any, arguments: Any, count: int) -> Iterator[Any]:
    """Yield a pointer to each of `count` numbers of an array (float64), the first `at`, the next `width` later."""
    data, at, width = arguments
    view = context.make_array(array)(context, builder, data)
    for _ in range(count):
        yield cgutils.get_item_pointer(context, builder, array, view, [at], wraparound=False)
        at = builder.add(at, width)
