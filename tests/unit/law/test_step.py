"""The step of the one law form: its sums, its kinematics."""

import math
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction

import numba
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gustproof.checker.estimate_box import trigonometry
from gustproof.law.form import Law, Schedule, list_laws, load_law
from gustproof.law.step import (
    EXTRA_SIZE,
    STEEP,
    TERM_BLOCK,
    LawStepper,
    euler_rates,
    no_law,
    rate_excess,
    sparse_law,
    step,
    tilt,
    turn_steep,
)

Maker = Callable[..., Law]


def kinematics(phi: float, theta: float) -> np.ndarray:
    """Return `T(E)`: body rates to Euler rates."""
    return np.array(
        [
            [1.0, math.sin(phi) * math.tan(theta), math.cos(phi) * math.tan(theta)],
            [0.0, math.cos(phi), -math.sin(phi)],
            [0.0, math.sin(phi) / math.cos(theta), math.cos(phi) / math.cos(theta)],
        ]
    )


def scheduled_outputs(schedule: Schedule, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return w by a general solution of its equation; at least one parameter is within its limit and one beyond."""
    sources = {"phi": x[0], "theta": x[1], "p": y[0], "q": y[1], "r": y[2]}
    own = np.array([sources[name] for name in schedule.parameters])
    within = np.clip(own, -schedule.limits, schedule.limits)
    assert np.any(within == own)
    assert np.any(within != own)
    angles = np.isin(schedule.parameters, ("phi", "theta"))
    delta = np.where(angles, np.tan(within / 2.0) / np.tan(schedule.limits / 2.0), within / schedule.limits)
    Delta = np.diag(delta)
    return np.linalg.solve(np.eye(len(own)) - Delta @ schedule.L, Delta @ (schedule.J @ x + schedule.K @ y))


def test_kernels_are_compiled_once_for_every_law(turn: Maker) -> None:
    laws = [*map(load_law, list_laws()), turn(load_law("hinf-d1"))]
    terms = [no_law(), *map(sparse_law, laws)]
    assert len({tuple(map(numba.typeof, each)) for each in terms}) == 1


def test_a_schedule_changes_no_bit_at_level_rest(turn: Maker) -> None:
    law, rng = load_law("hinf-d1"), np.random.default_rng(6)
    x, y = np.array([0.0, 0.0, *rng.normal(size=7)]), np.array([0.1, -0.2, 0.0, 0.0, 0.0, 0.0])
    for free, turned in zip(step(law, x, y), step(turn(law), x, y), strict=True):
        assert free.tobytes() == turned.tobytes()


@pytest.mark.parametrize("limited", [False, True])
@pytest.mark.parametrize("measured", [6, 8])
@pytest.mark.parametrize(("scheduled", "turned"), [(False, False), (True, False), (False, True)])
def test_a_step_is_the_stated_form(
    make_law: Maker, turn: Maker, scheduled: bool, measured: int, limited: bool, turned: bool
) -> None:
    law = make_law(scheduled=scheduled, measured=measured, limited=limited)
    law = turn(law) if turned else law
    rng = np.random.default_rng(2)
    x, y = rng.normal(size=7), rng.normal(size=6 if measured == 6 else 9)
    seen = y
    if measured == 8:
        assert np.all(np.abs(x[:2]) < 1.0)  # the tilt is described as usual
        seen = np.array([*y[:6], math.atan2(-y[7], -y[8]), math.atan2(y[6], math.hypot(y[7], y[8]))])
    excess, to_command, to_state = np.zeros(3), np.zeros((3, 3)), np.zeros((7, 3))
    if (limit := law.rate_limit) is not None:
        s = limit.S @ x + limit.T @ seen
        roll, pitch = x[:2] - np.clip(x[:2], -law.attitude_limits[:2], law.attitude_limits[:2])
        excess = np.linalg.inv(kinematics(roll, pitch)) @ np.clip(s, -limit.limits, limit.limits) - s
        assert np.abs(excess).min() > 0.01
        to_command, to_state = limit.U, limit.V
    w, at_command, at_state = np.zeros(1), np.zeros((3, 1)), np.zeros((7, 1))
    if law.schedule is not None:
        w, at_command, at_state = scheduled_outputs(law.schedule, x, seen), law.schedule.P, law.schedule.Q
    u = law.C @ x + law.D @ seen + to_command @ excess + at_command @ w
    command = np.clip(u, -law.limits, law.limits)
    assert np.any(command != u)
    rates = kinematics(*x[:2]) @ x[3:6]
    expected = law.A @ x + law.B @ seen + law.G @ rates + law.H @ (command - u) + to_state @ excess
    expected += at_state @ w
    x_next, flown = step(law, x, y)
    np.testing.assert_allclose(flown, command, rtol=1e-13)
    np.testing.assert_allclose(x_next, expected, rtol=1e-12, atol=1e-12)


def test_a_rate_within_its_limit_changes_no_bit(make_law: Maker) -> None:
    law, rng = make_law(limited=True), np.random.default_rng(3)
    assert law.rate_limit is not None
    wide = replace(law, rate_limit=replace(law.rate_limit, limits=np.full(3, 100.0)))
    free, differ = replace(law, rate_limit=None), 0
    for x, y in zip(rng.normal(size=(50, 7)), rng.normal(size=(50, 6)), strict=True):
        for ours, theirs in zip(step(wide, x, y), step(free, x, y), strict=True):
            assert ours.tobytes() == theirs.tobytes()
        differ += step(law, x, y)[0].tobytes() != step(free, x, y)[0].tobytes()
    assert differ > 25


def force_at_rest(phi: float, theta: float) -> np.ndarray:
    return -9.81 * np.array([-math.sin(theta), math.sin(phi) * math.cos(theta), math.cos(phi) * math.cos(theta)])


@pytest.mark.parametrize(("phi", "theta"), [(0.3, -0.2), (2.8, 1.2), (-3.0, -1.5), (1.5, 1.5), (0.0, 0.0)])
def test_tilt_is_the_attitude_of_a_body_at_rest(phi: float, theta: float) -> None:
    assert tilt(force_at_rest(phi, theta), (0.0, 0.0)) == pytest.approx((phi, theta), abs=1e-14)
    assert tilt(3.0 * force_at_rest(phi, theta), (0.0, 0.0)) == pytest.approx((phi, theta), abs=1e-14)


@pytest.mark.parametrize(("phi", "theta"), [(0.3, 2.0), (-0.4, -1.8), (4.0, 0.2), (-9.0, 3.0), (2.5, 6.0), (7.0, -4.5)])
def test_tilt_follows_the_estimates_over_the_vertical_and_through_whole_turns(phi: float, theta: float) -> None:
    near = (phi - 0.05, theta + 0.04)
    assert tilt(force_at_rest(phi, theta), near) == pytest.approx((phi, theta), abs=1e-13)


def test_tilt_stays_bounded_whatever_is_felt() -> None:
    assert tilt((0.0, 0.0, 0.0), (0.0, 0.0)) == (0.0, 0.0)
    rng = np.random.default_rng(5)
    for force, attitude in zip(rng.normal(0.0, 100.0, (200, 3)), rng.normal(0.0, 5.0, (200, 2)), strict=True):
        roll, pitch = tilt(force, attitude) - attitude
        assert abs(roll) <= math.pi + 1e-12
        assert abs(pitch) <= math.pi + 1e-12


def test_within_the_attitude_limits_commanded_euler_rates_are_body_rates() -> None:
    limits, angles = (3.0, 3.0, 3.0), (0.4, 0.3, 0.2)
    assert rate_excess((2.9, -2.9, 1.0), (0.39, -0.29), limits, angles) == (0.0, 0.0, 0.0)
    assert rate_excess((3.5, -4.0, 1.0), (0.39, -0.29), limits, angles) == (-0.5, 1.0, 0.0)
    p, q, r = rate_excess((0.0, 0.0, 1.0), (0.4, math.pi / 2.0 + 0.3), limits, angles)
    assert (p, q, r) == pytest.approx((-1.0, 0.0, -1.0), abs=1e-12)  # nose up: yaw is about the roll axis


def test_a_step_leaves_its_arguments_alone(make_law: Maker) -> None:
    law, x, y = make_law(), np.ones(7), np.ones(6)
    step(law, x, y)
    assert (x == 1.0).all()
    assert (y == 1.0).all()


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("name", ["aided", "pid-fair", "hinf-d1", "hinf-scheduled", "hinf-rates"])
def test_a_flying_law_gives_the_bits_of_step(name: str, turned: bool, turn: Maker) -> None:
    law = turn(load_law(name)) if turned else load_law(name)
    scale, reference = (0.7, 1.5, 3.0), (0.1, -0.2, 0.3)
    flying, x = LawStepper(law, scale), np.zeros(law.order)
    flying.set_reference(reference)
    for gyro, force in np.random.default_rng(3).normal(size=(50, 2, 3)).tolist():
        x, command = step(law, x, np.array([*gyro, *reference, *force]))
        assert flying.step(tuple(gyro), tuple(force)) == tuple((command / scale).astype(np.float32).tolist())


def test_a_law_without_accelerometer_gives_the_same_bits_with_and_without_its_numbers(
    make_law: Maker,
) -> None:
    law, rng = make_law(), np.random.default_rng(4)
    x, y = rng.normal(size=7), rng.normal(size=9)
    for short, full in zip(step(law, x, y[:6]), step(law, x, y), strict=True):
        assert short.tobytes() == full.tobytes()


def test_a_law_that_feels_force_is_not_stepped_without_it(make_law: Maker) -> None:
    with pytest.raises(ValueError, match=r"y has shape \(6,\), must be \(9,\)"):
        step(make_law(measured=8), np.zeros(7), np.zeros(6))


@pytest.mark.parametrize("theta", [math.pi / 2.0, -math.pi / 2.0, 1.6])
def test_the_kinematics_stay_bounded_where_they_are_singular(theta: float) -> None:
    assert max(abs(rate) for rate in euler_rates((0.4, theta, 0.0), (1.0, 1.0, 1.0))) < 50.0


@pytest.mark.parametrize("pitch_deg", [61.0, 80.0, 89.9999, 90.0, 100.0, -75.0, -90.0])
def test_at_a_steep_pitch_the_attitude_moves_by_the_exact_rotation(make_law: Maker, pitch_deg: float) -> None:
    law, rng, dt = make_law(), np.random.default_rng(6), 0.004
    for x, y, omega in zip(rng.normal(size=(20, 7)), rng.normal(size=(20, 6)), rng.normal(size=(20, 3)), strict=True):
        x[1], x[3:6] = math.radians(pitch_deg), 5.0 * omega
        rates = np.array(euler_rates(x[:3], x[3:6]))
        angles = turn_steep(x[:3], x[3:6], rates, dt, x[:3] + dt * rates)
        turned = Rotation.from_euler("ZYX", x[2::-1]) * Rotation.from_rotvec(dt * x[3:6])
        off = Rotation.from_euler("ZYX", angles[::-1]).inv() * turned
        assert off.magnitude() <= np.linalg.norm(dt * x[3:6]) ** 3 / 12.0 + 1e-12
        assert abs(angles[1]) <= math.pi / 2.0
        assert abs(angles[0] - x[0]) <= math.pi
        expected = step(replace(law, G=np.zeros((7, 3))), x, y)[0] + law.G @ rates
        expected[:3] = turn_steep(x[:3], x[3:6], rates, dt, expected[:3])
        np.testing.assert_allclose(step(law, x, y)[0], expected, rtol=1e-12, atol=1e-12)


def test_a_pitch_that_is_not_steep_moves_by_its_rates() -> None:
    assert turn_steep((0.1, STEEP, 0.3), (1.0, 2.0, 3.0), (4.0, 5.0, 6.0), 0.004, (7.0, 8.0, 9.0)) == (7.0, 8.0, 9.0)
    assert turn_steep((0.1, -STEEP, 0.3), (1.0, 2.0, 3.0), (4.0, 5.0, 6.0), 0.004, (7.0, 8.0, 9.0)) == (7.0, 8.0, 9.0)


def test_no_proof_reaches_a_steep_pitch() -> None:
    trigonometry([Fraction(1), Fraction(1)])
    with pytest.raises(ValueError, match="must be"):
        trigonometry([Fraction(0), Fraction(STEEP)])


@pytest.mark.slow
@pytest.mark.parametrize("axis", [(0.0, 1.0, 0.0), (0.01, 1.0, 0.0), (0.0, -1.0, 0.02)])
def test_whole_turns_over_the_vertical_keep_the_attitude(axis: tuple[float, ...]) -> None:
    law, dt = load_law("flagship"), 0.004
    rate = 2.0 * math.pi * np.array(axis) / np.linalg.norm(axis)  # a turn a second
    x, y = np.zeros(law.order), np.array([*rate, 0.0, 0.0, 0.0])
    x[3:6], off = rate, []
    for k in range(1, 501):
        x, _ = step(law, x, y)
        own = Rotation.from_euler("ZYX", x[2::-1])
        off.append((own.inv() * Rotation.from_rotvec(k * dt * rate)).magnitude())
    assert max(off) <= math.radians(0.5)


@pytest.mark.parametrize("name", ["hinf-scheduled", "flagship", "aided", "pid-default"])
def test_the_sums_hold_every_coefficient_that_is_not_zero_in_whole_fours(name: str) -> None:
    law = load_law(name)
    n, summed = law.order, sparse_law(law)
    assert (np.diff(summed.ends, prepend=0) >= TERM_BLOCK).all()
    assert (np.diff(summed.ends, prepend=0) % TERM_BLOCK == 0).all()
    dense, rows = (
        np.zeros((len(summed.ends), n + EXTRA_SIZE)),
        np.searchsorted(summed.ends, np.arange(len(summed.terms)), side="right"),
    )
    np.add.at(dense, (rows, summed.terms[:, 0].astype(int)), summed.terms[:, 1])
    m, filled = law.D.shape[1], sum(np.count_nonzero(getattr(law, part)) for part in "ABCDGH")
    assert np.count_nonzero(dense[-3 - n :, : n + 15]) == filled
    if (limit := law.rate_limit) is not None:
        assert (dense[:3, :n] == limit.S).all()
        assert (dense[:3, n : n + m] == limit.T).all()
        assert (dense[3:6, n + 15 : n + 18] == limit.U).all()
        assert (dense[6:, n + 15 : n + 18] == limit.V).all()
        filled += sum(np.count_nonzero(getattr(limit, part)) for part in "STUV")
    assert np.count_nonzero(dense) == filled
    dense = dense[-3 - n :]
    assert (dense[:3, :n] == law.C).all()
    assert (dense[3:, :n] == law.A).all()
    assert (dense[:3, n : n + m] == law.D).all()
    assert (dense[3:, n : n + m] == law.B).all()
    assert (dense[3:, n + 9 : n + 12] == law.G).all()
    assert (dense[3:, n + 12 : n + 15] == law.H).all()


def test_axes_that_have_no_coefficient_in_common_do_not_spoil_each_other() -> None:
    law = load_law("pid-default")
    x_next, command = step(law, np.zeros(law.order), np.array([math.nan, 0.1, 0.2, 0.0, 0.0, 0.0]))
    assert np.isnan(command[0])
    assert np.isfinite(command[1:]).all()
    assert np.isfinite(x_next).any()


def test_a_law_without_states_and_coefficients_commands_nothing(make_law: Maker) -> None:
    empty = {"A": (0, 0), "B": (0, 6), "C": (3, 0), "D": (3, 6), "G": (0, 3), "H": (0, 3)}
    law = replace(make_law(), **{name: np.zeros(shape) for name, shape in empty.items()})
    x_next, command = step(law, np.zeros(0), np.ones(6))
    assert x_next.size == 0
    assert (command == 0.0).all()
