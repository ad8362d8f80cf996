"""Numbers of many flights in one array."""

from typing import NamedTuple

import numpy as np
import pytest

from firmware_model.numerics.compiled import compiled
from firmware_model.numerics.soa import (
    Lane,
    aligned_zeros,
    field_offset,
    flatten,
    loader,
    mover,
    offsets,
    storer,
    summer,
)


class Triple(NamedTuple):
    """A row of three."""

    a: float
    b: float
    c: float


class Nested(NamedTuple):
    """A number, a vector and a row in a row."""

    a: float
    v: tuple[float, float]
    t: Triple


load, store = loader(Triple), storer(Triple)
load_nested, store_nested = loader(Nested), storer(Nested)


@pytest.mark.parametrize("size", [1, 8, 333])
def test_aligned_zeros_begin_at_a_cache_line(size: int) -> None:
    zeros = aligned_zeros(size)
    assert zeros.shape == (size,)
    assert (zeros == 0.0).all()
    assert zeros.ctypes.data % 64 == 0


@compiled
def _exchange(lane: Lane, row: int, value: Triple) -> Triple:
    before = load(lane, row)
    store(lane, row, value)
    return before


def _exchange_in_python(lane: Lane, row: int, value: Triple) -> Triple:
    before = load(lane, row)
    store(lane, row, value)
    return before


@pytest.mark.parametrize("exchange", [_exchange, _exchange_in_python])
def test_load_and_store_take_one_lane_from_a_row_on(exchange) -> None:
    array = np.arange(10.0)  # five rows, two flights
    before = exchange(Lane(array, 2, 1), 1, Triple(-1.0, -2.0, -3.0))
    assert before == Triple(3.0, 5.0, 7.0)
    assert isinstance(before, Triple)
    assert array.tolist() == [0.0, 1.0, 2.0, -1.0, 4.0, -2.0, 6.0, -3.0, 8.0, 9.0]


@compiled
def _double(lane: Lane) -> Nested:
    before = load_nested(lane, 1)
    store_nested(lane, 1, Nested(2.0 * before.a, (before.v[1], before.v[0]), before.t))
    return before


def _double_in_python(lane: Lane) -> Nested:
    before = load_nested(lane, 1)
    store_nested(lane, 1, Nested(2.0 * before.a, (before.v[1], before.v[0]), before.t))
    return before


@pytest.mark.parametrize("double", [_double, _double_in_python])
def test_tuples_in_a_row_take_a_row_for_each_number(double) -> None:
    array = np.arange(14.0)  # seven rows, two flights
    before = double(Lane(array, 2, 0))
    assert before == Nested(2.0, (4.0, 6.0), Triple(8.0, 10.0, 12.0))
    assert isinstance(before.t, Triple)
    assert flatten(before) == [2.0, 4.0, 6.0, 8.0, 10.0, 12.0]
    assert array.tolist() == [0.0, 1.0, 4.0, 3.0, 6.0, 5.0, 4.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0]
    assert [field_offset(Nested, name) for name in Nested._fields] == [0, 1, 3]


def test_offsets_are_the_rows_of_packed_tuples_and_the_end() -> None:
    assert offsets([Triple, Lane, Triple]) == [0, 3, 6, 9]


sum_pair, move_pair = summer(2), mover(2)


@compiled
def _sum_pairs(terms: np.ndarray, begin: int, end: int, rows: np.ndarray) -> None:
    sum_pair(terms, begin, end, rows, rows[2])


def _sum_pairs_in_python(terms: np.ndarray, begin: int, end: int, rows: np.ndarray) -> None:
    sum_pair(terms, begin, end, rows, rows[2])


@pytest.mark.parametrize("total", [_sum_pairs, _sum_pairs_in_python])
def test_a_sum_adds_its_terms_in_order_and_may_replace_one_of_them(total) -> None:
    rows = np.array([[1e16, 1.0], [1.0, 2.0], [-1e16, 3.0]])
    terms = np.array([(1.0, 9.0), (0.0, 1.0), (1.0, 1.0), (2.0, 1.0), (1.0, 9.0)])
    total(terms, 1, 4, rows)
    assert rows.tolist() == [[1e16, 1.0], [1.0, 2.0], [0.0, 6.0]]  # another order gives 1 in place of 0
    total(terms, 2, 2, rows)
    assert rows[2].tolist() == [0.0, 0.0]


@compiled
def _move_pair(rows: np.ndarray) -> None:
    move_pair(rows, 1, rows, 2)


def _move_pair_in_python(rows: np.ndarray) -> None:
    move_pair(rows, 1, rows, 2)


@pytest.mark.parametrize("move", [_move_pair, _move_pair_in_python])
def test_moved_numbers_may_overlap(move) -> None:
    rows = np.arange(6.0).reshape(2, 3)
    move(rows)
    assert rows.tolist() == [[0.0, 1.0, 1.0], [2.0, 4.0, 5.0]]
