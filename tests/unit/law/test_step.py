"""The step of the one law form: its sums, its kinematics."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gustproof.law.form import Law, load_law
from gustproof.law.step import EXTRA_SIZE, TERM_BLOCK, LawStepper, euler_rates, sparse_law, step

Maker = Callable[..., Law]


@pytest.mark.parametrize("measured", [6, 9])
@pytest.mark.parametrize("scheduled", [False, True])
def test_a_step_is_the_stated_form(make_law: Maker, scheduled: bool, measured: int) -> None:
    law = make_law(scheduled=scheduled, measured=measured)
    rng = np.random.default_rng(2)
    x, y = rng.normal(size=7), rng.normal(size=measured)
    phi, theta = x[0], x[1]
    T = np.array(
        [
            [1.0, math.sin(phi) * math.tan(theta), math.cos(phi) * math.tan(theta)],
            [0.0, math.cos(phi), -math.sin(phi)],
            [0.0, math.sin(phi) / math.cos(theta), math.cos(phi) / math.cos(theta)],
        ]
    )
    u = law.C @ x + law.D @ y
    command = np.clip(u, -law.limits, law.limits)
    assert np.any(command != u)
    expected = law.A @ x + law.B @ y + law.G @ (T @ x[3:6]) + law.H @ (command - u)
    x_next, flown = step(law, x, y)
    np.testing.assert_allclose(flown, command, rtol=1e-13)
    np.testing.assert_allclose(x_next, expected, rtol=1e-12, atol=1e-13)


def test_a_step_leaves_its_arguments_alone(make_law: Maker) -> None:
    law, x, y = make_law(), np.ones(7), np.ones(6)
    step(law, x, y)
    assert (x == 1.0).all()
    assert (y == 1.0).all()


@pytest.mark.parametrize("name", ["aided", "pid-fair", "hinf-d1", "hinf-scheduled", "hinf-rates"])
def test_a_flying_law_gives_the_bits_of_step(name: str) -> None:
    law = load_law(name)
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
        step(make_law(measured=9), np.zeros(7), np.zeros(6))


@pytest.mark.parametrize("theta", [math.pi / 2.0, -math.pi / 2.0, 1.6])
def test_the_kinematics_stay_bounded_where_they_are_singular(theta: float) -> None:
    assert max(abs(rate) for rate in euler_rates((0.4, theta, 0.0), (1.0, 1.0, 1.0))) < 50.0


@pytest.mark.parametrize("name", ["hinf-scheduled", "flagship", "aided", "pid-default"])
def test_the_sums_hold_every_coefficient_that_is_not_zero_in_whole_fours(name: str) -> None:
    law = load_law(name)
    n, summed = law.order, sparse_law(law)
    assert (np.diff(summed.ends, prepend=0) >= TERM_BLOCK).all()
    assert (np.diff(summed.ends, prepend=0) % TERM_BLOCK == 0).all()
    dense, rows = (
        np.zeros((3 + n, n + EXTRA_SIZE)),
        np.searchsorted(summed.ends, np.arange(len(summed.terms)), side="right"),
    )
    np.add.at(dense, (rows, summed.terms[:, 0].astype(int)), summed.terms[:, 1])
    m = law.D.shape[1]
    assert (dense[:3, :n] == law.C).all()
    assert (dense[3:, :n] == law.A).all()
    assert (dense[:3, n : n + m] == law.D).all()
    assert (dense[3:, n : n + m] == law.B).all()
    assert (dense[3:, n + 9 : n + 12] == law.G).all()
    assert (dense[3:, n + 12 : n + 15] == law.H).all()
    assert np.count_nonzero(dense) == sum(np.count_nonzero(getattr(law, part)) for part in "ABCDGH")


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
