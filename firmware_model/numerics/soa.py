"""Pack NamedTuples of floats and vectors into rows of one array, several flights side by side; load them in kernels.

Python hands one array to a compiled function in a tenth of the time that forty numbers take. Several flights share an
array, one per lane: each row holds the same number of every flight, so that the compiler finds SIMD in a loop over
lanes.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.types.containers import BaseTuple
from numba.extending import intrinsic, overload
from numpy.typing import NDArray

from firmware_model.numerics.compiled import INLINED, kernel
from firmware_model.types import Vector

Row = TypeVar("Row", bound=tuple[Any, ...])
Matrix = NDArray[np.float64]
_NUMBER = 8  # [B]


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
    count, nest, gather = _count(kind), _make_nest(kind), intrinsic(_make_gather(kind))

    def load(lane: Lane, row: int) -> Row:
        at = row * lane.width + lane.number
        loaded: Row = nest(iter(lane.array[at : at + count * lane.width : lane.width]))
        return loaded

    def overload_load(_lane: Any, _row: Any) -> Any:
        return lambda lane, row: gather(lane.array, row * lane.width + lane.number, lane.width)

    overload(load, **INLINED)(overload_load)
    return load


def storer(kind: type[Row]) -> Callable[[Lane, int, Row], None]:
    """Return the kernel `store(lane, row, value)` that writes the fields of `value`, the first of them to `row`."""
    count, scatter = _count(kind), intrinsic(_scatter)

    def store(lane: Lane, row: int, value: Row) -> None:
        at = row * lane.width + lane.number
        lane.array[at : at + count * lane.width : lane.width] = flatten(value)

    def overload_store(_lane: Any, _row: Any, _value: Any) -> Any:
        return lambda lane, row, value: scatter(lane.array, row * lane.width + lane.number, lane.width, value)

    overload(store, **INLINED)(overload_store)
    return store


def summer(width: int) -> Callable[[Matrix, int, int, Matrix, Matrix], None]:
    """Return the kernel `total(terms, begin, end, rows, sums)` that sums rows of `width` flights, each with a factor.

    `terms` (m, 2) holds the number of a row and its factor; those from `begin` up to `end` are added to 0 in order.
    `rows` (n, width) and `sums` (width,) may overlap. The sums stay in registers between terms. A loop over flights
    for each term would load and store them, which takes most of the time.
    """
    add_up = intrinsic(_make_sum(width))

    def total(terms: Matrix, begin: int, end: int, rows: Matrix, sums: Matrix) -> None:
        added = np.zeros(width)
        for row, factor in terms[begin:end]:
            added = added + factor * rows[int(row)]
        sums[:] = added

    def overload_total(_terms: Any, _begin: Any, _end: Any, _rows: Any, _sums: Any) -> Any:
        return lambda terms, begin, end, rows, sums: add_up(terms, begin, end, rows, sums)

    overload(total, **INLINED)(overload_total)
    return total


def mover(count: int) -> Callable[[Matrix, int, Matrix, int], None]:
    """Return the kernel `move(source, at, target, to)` that copies `count` numbers, from `at` on to `to` on.

    The arrays are taken as flat, and may overlap. One vector is moved: of a loop so short the compiler makes single
    numbers.
    """
    copy = intrinsic(_make_move(count))

    def move(source: Matrix, at: int, target: Matrix, to: int) -> None:
        target.reshape(-1)[to : to + count] = source.reshape(-1)[at : at + count]

    def overload_move(_source: Any, _at: Any, _target: Any, _to: Any) -> Any:
        return lambda source, at, target, to: copy(source, at, target, to)

    overload(move, **INLINED)(overload_move)
    return move


def offsets(kinds: Iterable[Any]) -> list[int]:
    """Return the row at which each of `kinds` starts when they are packed in order, and the end."""
    return [0, *np.cumsum([_count(kind) for kind in kinds]).tolist()]


def field_offset(kind: Any, name: str) -> int:
    """Return the row of a field of `kind`, from the first of its rows."""
    row: int = offsets(_fields(kind))[kind._fields.index(name)]
    return row


def flatten(row: Iterable[Any]) -> list[float]:
    """Return the numbers of a NamedTuple and of the tuples in it, in the order of the rows."""
    numbers: list[float] = []
    for item in row:
        if isinstance(item, tuple):
            numbers += flatten(item)
        else:
            numbers.append(item)
    return numbers


def _fields(kind: Any) -> tuple[Any, ...]:
    """Return the types of the fields of a tuple; none for a number."""
    if hasattr(kind, "_fields"):
        return tuple(get_type_hints(kind).values())
    return get_args(kind) if get_origin(kind) is tuple else ()


def _count(kind: Any) -> int:
    """Return the number of rows of a `kind`."""
    return sum(map(_count, _fields(kind))) or 1


def _make_nest(kind: Any) -> Callable[[Iterator[float]], Any]:
    """Return what makes a `kind` of the next numbers; the types are read here, not for each row."""
    parts = [_make_nest(field) for field in _fields(kind)]
    if not parts:
        return next
    make = kind._make if hasattr(kind, "_fields") else tuple
    return lambda numbers: make([part(numbers) for part in parts])


def _compiled_type(kind: Any) -> Any:
    """Return numba's type of a `kind`."""
    parts = [_compiled_type(field) for field in _fields(kind)]
    if not parts:
        return types.float64
    return BaseTuple.from_types(parts, kind if hasattr(kind, "_fields") else None)


# A compiled function can't loop over the fields of a tuple, so these two write out LLVM instructions field by field.
def _make_gather(kind: Any) -> Callable[..., Any]:
    """Return the typing of the intrinsic `gather(array, at, width) -> kind`."""
    count, gathered = _count(kind), _compiled_type(kind)

    def gather(_: Any, array: Any, at: Any, width: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            pointers = _field_pointers(context, builder, array, arguments, count)

            def make(part: Any) -> Any:
                if part is types.float64:
                    return builder.load(next(pointers))
                return context.make_tuple(builder, part, [make(item) for item in part.types])

            return make(gathered)

        return gathered(array, types.intp, types.intp), generate

    return gather


def _scatter(_: Any, array: Any, at: Any, width: Any, row: Any) -> Any:
    """Return the typing of the intrinsic `scatter(array, at, width, row)`."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        *position, values = arguments
        leaves = list(_leaves(builder, values, row))
        pointers = _field_pointers(context, builder, array, position, len(leaves))
        for (value, kind), pointer in zip(leaves, pointers, strict=True):
            builder.store(context.cast(builder, value, kind, types.float64), pointer)
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, row), generate


def _make_sum(width: int) -> Callable[..., Any]:
    """Return the typing of the intrinsic `add_up(terms, begin, end, rows, sums)`, see `summer`."""
    vector = ir.VectorType(ir.DoubleType(), width)

    def add_up(_: Any, terms: Any, begin: Any, end: Any, rows: Any, sums: Any) -> Any:
        kinds = (terms, rows, sums)

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            data, (first, last) = (arguments[0], *arguments[3:]), arguments[1:3]
            term, row, target = (
                context.make_array(kind)(context, builder, value).data for kind, value in zip(kinds, data, strict=True)
            )
            added = cgutils.alloca_once_value(builder, ir.Constant(vector, [0.0] * width))
            with cgutils.for_range_slice(builder, first, last, ir.Constant(first.type, 1)) as (t, _):
                at = builder.shl(t, ir.Constant(t.type, 1))
                number = builder.fptosi(builder.load(builder.gep(term, [at])), t.type)
                factor = builder.load(builder.gep(term, [builder.add(at, ir.Constant(t.type, 1))]))
                start = builder.gep(row, [builder.mul(number, ir.Constant(t.type, width))])
                numbers = builder.load(builder.bitcast(start, vector.as_pointer()), align=_NUMBER)
                product = builder.fmul(spread(builder, factor, vector), numbers)
                builder.store(builder.fadd(builder.load(added), product), added)
            builder.store(builder.load(added), builder.bitcast(target, vector.as_pointer()), align=_NUMBER)
            return context.get_dummy_value()

        return types.void(terms, types.intp, types.intp, rows, sums), generate

    return add_up


def _make_move(count: int) -> Callable[..., Any]:
    """Return the typing of the intrinsic `copy(source, at, target, to)`, see `mover`."""
    vector = ir.VectorType(ir.DoubleType(), count).as_pointer()

    def copy(_: Any, source: Any, at: Any, target: Any, to: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            start, end = (
                builder.bitcast(builder.gep(context.make_array(kind)(context, builder, array).data, [first]), vector)
                for kind, array, first in ((source, *arguments[:2]), (target, *arguments[2:]))
            )
            builder.store(builder.load(start, align=_NUMBER), end, align=_NUMBER)
            return context.get_dummy_value()

        return types.void(source, types.intp, target, types.intp), generate

    return copy


def spread(builder: Any, value: Any, vector: Any) -> Any:
    """Return a vector of equal numbers, in LLVM's instructions."""
    unset, zero = ir.Constant(vector, ir.Undefined), ir.Constant(ir.IntType(32), 0)
    first = builder.insert_element(unset, value, zero)
    return builder.shuffle_vector(first, unset, ir.Constant(ir.VectorType(zero.type, vector.count), None))


def _leaves(builder: Any, value: Any, kind: Any) -> Iterator[tuple[Any, Any]]:
    """Yield each number in a compiled tuple, with its type."""
    if not isinstance(kind, BaseTuple):
        yield value, kind
        return
    for i, part in enumerate(kind.types):
        yield from _leaves(builder, builder.extract_value(value, i), part)


def _field_pointers(context: Any, builder: Any, array: Any, arguments: Any, count: int) -> Iterator[Any]:
    """Yield a pointer to each of `count` numbers of an array (float64), the first `at`, the next `width` later."""
    data, at, width = arguments
    view = context.make_array(array)(context, builder, data)
    for _ in range(count):
        yield cgutils.get_item_pointer(context, builder, array, view, [at], wraparound=False)
        at = builder.add(at, width)
