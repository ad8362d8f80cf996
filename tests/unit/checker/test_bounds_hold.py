"""Bounds of the checker hold of motions that are drawn, and no input of a bound is left out or counts the wrong way."""

from collections.abc import Callable
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from firmware_model.config.vehicle import vehicle_path
from gustproof.checker import attitude_offset, estimate_box, kernel_norms, single_precision, truth_drift
from gustproof.checker.kernel_norms import X0, X1, axis_norms
from gustproof.checker.system import LoopSystem, read_system
from gustproof.checker.truth_drift import Disturbance
from gustproof.law.form import LAWS

ROUNDING = 1e-9
"""[-] of the numbers that are compared, in doubles."""
SMALL = st.floats(0.01, 0.3)
UNIT = st.floats(-1.0, 1.0)


def three(values: st.SearchStrategy[float]) -> st.SearchStrategy[list[float]]:
    return st.lists(values, min_size=3, max_size=3)


def exact(values: Any) -> list[Fraction]:
    return [Fraction(value) for value in values]


def euler_rates(E: Any, omega: Any) -> Any:
    """Return T(E) omega, of complex numbers too."""
    phi, theta, (p, q, r) = E[0], E[1], omega
    a, b = np.sin(phi) * q + np.cos(phi) * r, np.cos(phi) * q - np.sin(phi) * r
    return np.array([p + np.tan(theta) * a, b, a / np.cos(theta)])


def second_derivative(E: Any, omega: Any, change: Any) -> Any:
    """Return E'' of the flow `E' = T(E) omega` for a rate that changes by `change`, by a complex step."""
    step = 1e-30j
    return euler_rates(E + step * euler_rates(E, omega), omega + step * change).imag / step.imag


def assert_below(found: Any, bounds: list[Fraction], slack: float = ROUNDING) -> None:
    limits = np.array([float(value) for value in bounds])
    assert np.all(np.abs(found) <= limits * (1.0 + slack) + slack * ROUNDING), (found, limits)


@given(E=three(SMALL), omega=three(SMALL), change=three(SMALL), at=st.lists(UNIT, min_size=15, max_size=15))
@settings(max_examples=40)
def test_kinematics_within_a_box_stay_below_their_bounds(E, omega, change, at):
    angles, others, rates, other_rates, slopes = np.array(at).reshape(5, 3) * [E, E, omega, omega, change]
    box, moves, off = exact(E), exact(omega), exact(np.abs(angles - others))
    assert_below(euler_rates(angles, rates) - rates, estimate_box.excess(box, moves))
    turned = euler_rates(angles, rates) - euler_rates(others, rates)
    assert_below(turned, truth_drift.slope_of_T(box, moves, off))
    bounds = truth_drift._angles(box, moves, exact(change))
    assert_below(second_derivative(angles, rates, slopes), bounds.second)
    step = 1e-5 * euler_rates(angles, rates), 1e-5 * slopes
    ahead, behind = (second_derivative(angles + k * step[0], rates + k * step[1], slopes) for k in (1.0, -1.0))
    third = (ahead - behind) / 2e-5
    assert np.all(np.abs(third) <= np.array([float(value) for value in bounds.third]) * (1 + 1e-5) + 1e-7)
    law, apart = loop("flagship"), exact(np.abs(rates - other_rates))
    rows, differences = (
        [[Fraction(0)] * X0 + [a, b] for a, b in zip(*pair, strict=True)] for pair in ((box, moves), (off, apart))
    )
    excess = (euler_rates(angles, rates) - rates) - (euler_rates(others, other_rates) - other_rates)
    assert_below(excess, single_precision._excess_difference(law, rows, differences))


@given(start=three(SMALL), budget=three(st.floats(0.0, 0.1)), at=st.lists(UNIT, min_size=21, max_size=21))
@settings(max_examples=40)
def test_rotations_in_any_order_stay_below_their_bounds(start, budget, at):
    signs = np.array(at).reshape(7, 3)
    attitude, vector = signs[0] * start, signs[1] * start
    turns = [Rotation.from_rotvec(each * budget / 5.0) for each in signs[2:]]  # together within the budget of each axis
    body = Rotation.from_euler("ZYX", attitude[::-1])
    nearby = body
    for turn in turns:
        vector, body, nearby = turn.apply(vector), body * turn, turn * nearby
    assert_below(vector, truth_drift._tilt(exact(budget), exact(np.abs(signs[1] * start))))
    for turned, excess in ((body, estimate_box.excess), (nearby, truth_drift._excess_N)):
        bounds = truth_drift._rotate(exact(start), exact(budget), excess)
        assert_below(turned.as_euler("ZYX")[::-1], bounds)


@cache
def loop(law: str) -> LoopSystem:
    """Return the loop of a law on the paper's vehicle, with damping on all axes."""
    found = read_system((LAWS / f"{law}.json").read_text(), vehicle_path("paper").read_text())
    return found._replace(damping=(Fraction(1, 4), Fraction(1, 2), Fraction(3, 8)))


def nested(values: Any) -> list[Any]:
    return [each for row in values for each in nested(row)] if isinstance(values, (list, tuple)) else [values]


def widened(values: Any, at: list[int]) -> Any:
    """Return nested rows with the number at a place made a quarter larger."""
    if not at:
        return values * Fraction(5, 4)
    rows = [widened(row, at[1:]) if k == at[0] else row for k, row in enumerate(values)]
    return rows if isinstance(values, list) else type(values)(*rows) if hasattr(values, "_fields") else tuple(rows)


def places(values: Any) -> list[list[int]]:
    """Return the places of the numbers in nested rows; those that are 0 can't be made larger."""
    if isinstance(values, (list, tuple)):
        return [[k, *place] for k, row in enumerate(values) for place in places(row)]
    return [[]] if isinstance(values, Fraction) and values else []


def unfelt(bound: Callable[..., Any], *inputs: Any) -> set[tuple[int, ...]]:
    """Return the inputs of which no bound rises; fail if one falls."""
    before, silent = nested(bound(*inputs)), set()
    for place in places(inputs):
        after = nested(bound(*widened(inputs, place)))
        assert all(b >= a for a, b in zip(before, after, strict=True)), place
        if after == before:
            silent.add(tuple(place))
    return silent


BOX = [[Fraction(7 + 5 * i + (3 + i) * k, 4096) for k in range(10)] for i in range(3)]
"""Box in which no two bounds are alike."""
CASE = estimate_box.EstimateCase(exact([0.0625, 0.03125, 0.046875]), Fraction(1, 1 << 14), Fraction(9, 2))
DISTURBANCE = Disturbance(
    unseen=exact([0.005, 0.01, 0.015]),
    slope=exact([0.04, 0.05, 0.06]),
    steps=64,
    risk=Fraction(1, 128),
    wrong_rates=exact([1e-4, 2e-4, 3e-4]),
)


def columns(silent: set[tuple[int, ...]], box: int) -> set[int]:
    """Return the signals of a box that are not felt on any axis; fail if one is felt on some axes alone."""
    found = {place[2] for place in silent}
    assert silent == {(box, axis, column) for axis in range(3) for column in found}
    return found


@cache
def norms() -> list[kernel_norms.AxisNorms]:
    return [axis_norms(loop("hinf-d1"), axis, 1024) for axis in range(3)]


def test_every_cause_is_felt_by_the_box_that_it_is_mapped_to():
    """But for the rate at the samples and the gap, which follow from others of the box."""
    silent = unfelt(lambda case, box: estimate_box.map_box(loop("hinf-d1"), norms(), case, box), CASE, BOX)
    assert columns(silent, 1) == {kernel_norms.OMEGA, len(BOX[0]) + estimate_box.SLEW}


def test_every_cause_is_felt_by_the_bound_of_the_truth(monkeypatch):
    monkeypatch.setattr(truth_drift, "_CHUNKS", 2)  # as good here, in a tenth of the time

    def bound(case: Any, box: Any, unseen: Any, slope: Any, wrong: Any, steps: int = 64) -> Any:
        changed = DISTURBANCE._replace(unseen=unseen, slope=slope, wrong_rates=wrong, steps=steps)
        return truth_drift.truth_bound(loop("hinf-d1"), case, box, changed)

    causes = (CASE, BOX, DISTURBANCE.unseen, DISTURBANCE.slope, DISTURBANCE.wrong_rates)
    silent = unfelt(bound, *causes)
    assert columns(silent, 1) == {kernel_norms.OMEGA, kernel_norms.COMMAND, 5, len(BOX[0]) + estimate_box.GAP}
    assert all(longer > shorter for longer, shorter in zip(bound(*causes, steps=80), bound(*causes), strict=True))


def test_every_size_is_felt_by_the_rounding_of_a_sum():
    form = single_precision.Form(frozenset({0, 1, 7}), Fraction(3, 4), [Fraction(k + 1, 64) for k in range(9)])
    reads = [exact([0.125, 0.0625, 0.25])] * 12

    def bound(case: Any, box: Any, heading: Fraction) -> Any:
        changed = form._replace(heading=heading)
        return [single_precision._row_error(loop("hinf-d1"), case, box, changed, reads, i) for i in range(12)]

    silent = {place for place in unfelt(bound, CASE, BOX, form.heading) if place[0] == 1}
    assert columns(silent, 1) == {0, 1, 2, 6, 7, 8}  # all but states and gyro


def test_the_integral_of_a_linear_laws_gyro_turns_with_the_excess_alone():
    held = DISTURBANCE._replace(unseen=exact([0.0] * 3), slope=exact([0.0] * 3), steps=2048)
    case, box = CASE._replace(noise=Fraction(0)), [[value / 64 for value in row] for row in BOX]
    rows, told = attitude_offset.strapdown_box(loop("hinf-d1"), norms(), case, box, held, 1024)
    assert told.wrong_rates == estimate_box.excess([row[X0] for row in rows], [row[X1] for row in rows])
    assert all(row[X0] > own[X0] for row, own in zip(rows, box, strict=True))
