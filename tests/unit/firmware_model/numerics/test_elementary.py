"""Elementary functions against the C library and published test vectors."""

import math

import numpy as np
import pytest
import scipy.special

from firmware_model.numerics.elementary import (
    BLOCK,
    arctan2,
    inverse_normal,
    inverse_normals,
    log,
    mixed_normals,
    normals,
    philox,
    sin_cos,
)


def test_sine_and_cosine_agree_with_the_c_library() -> None:
    x = np.random.default_rng(1).uniform(-1e5, 1e5, 2000)
    computed = np.array([sin_cos(v) for v in x])
    # Two roundings apart at most: one ulp of 1 is 2.2e-16.
    np.testing.assert_allclose(computed, np.column_stack([np.sin(x), np.cos(x)]), rtol=0.0, atol=2.3e-16)


@pytest.mark.parametrize(("y", "x"), [(0.0, 1.0), (1.0, 0.0), (-1.0, 0.0), (0.0, -1.0), (1.0, -1.0), (-1e-300, 1.0)])
def test_arctan2_on_the_axes(y: float, x: float) -> None:
    assert arctan2(y, x) == pytest.approx(math.atan2(y, x), rel=4e-16)


def test_arctan2_agrees_with_the_c_library() -> None:
    rng = np.random.default_rng(2)
    y, x = rng.normal(size=2000), rng.normal(size=2000)
    computed = np.array([arctan2(a, b) for a, b in zip(y, x, strict=True)])
    np.testing.assert_allclose(computed, np.arctan2(y, x), rtol=0.0, atol=4.5e-16)  # 1 ulp of pi


def test_arctan2_of_nothing_is_zero() -> None:
    assert arctan2(0.0, 0.0) == 0.0


def test_log_agrees_with_the_c_library() -> None:
    x = np.exp(np.random.default_rng(3).uniform(-40.0, 40.0, 2000))
    np.testing.assert_allclose([log(v) for v in x], np.log(x), rtol=4e-16, atol=2e-16)


def test_inverse_normal_agrees_with_scipy_to_the_far_tail() -> None:
    u = np.concatenate(
        [np.linspace(0.0005, 0.9995, 1999), np.logspace(-9.9, -3.0, 200), 1.0 - np.logspace(-9.9, -3, 200)]
    )
    np.testing.assert_allclose([inverse_normal(v) for v in u], scipy.special.ndtri(u), rtol=2e-15, atol=1e-16)


@pytest.mark.parametrize("share", [0.0, 0.15, 1.0])
def test_many_quantiles_are_those_one_by_one_wherever_the_numbers_lie(share: float) -> None:
    rng = np.random.default_rng(1)
    central, outer = rng.uniform(0.075, 0.925, 100), rng.choice([0.01, 0.99, 1e-9], 100) * rng.uniform(0.1, 1.0, 100)
    u = np.where(rng.random(100) < share, outer, central)
    quantiles = u.copy()
    inverse_normals(quantiles, np.empty(100 + BLOCK), np.empty(100, dtype=np.int32))
    assert quantiles.tolist() == [inverse_normal(value) for value in u]


@pytest.mark.parametrize(
    ("counter", "key", "expected"),
    [
        ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        ((2**32 - 1,) * 4, (2**32 - 1,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
        (
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            (0xA4093822, 0x299F31D0),
            (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
        ),
    ],
)
def test_philox_gives_the_known_answers(
    counter: tuple[int, int, int, int], key: tuple[int, int], expected: tuple[int, int, int, int]
) -> None:
    """Test vectors of the Random123 library, kat_vectors, philox4x32 10."""
    a, b, c, d = (np.uint64(word) for word in counter)
    assert philox((a, b, c, d), (np.uint64(key[0]), np.uint64(key[1]))) == expected


def test_normals_are_standard_normal() -> None:
    draw = np.array([normals(7, 1, sample, 0) for sample in range(5000)]).ravel()
    # 20,000 draws: five standard errors of mean, variance and kurtosis.
    assert abs(draw.mean()) < 5.0 / math.sqrt(draw.size)
    assert abs(draw.var() - 1.0) < 5.0 * math.sqrt(2.0 / draw.size)
    assert abs((draw**4).mean() - 3.0) < 5.0 * math.sqrt(96.0 / draw.size)


def test_mixed_normals_are_those_of_a_seed_and_then_turned_towards_others() -> None:
    first, second = (np.array(normals(seed, 2, 5, 1)) for seed in (7, 9))
    rows = np.array([(7.0, 0.0, 1.0), (9.0, 0.6, 0.8)])
    assert mixed_normals(rows[:1], 2, 5, 1) == tuple(first.tolist())
    np.testing.assert_allclose(mixed_normals(rows, 2, 5, 1), 0.6 * first + 0.8 * second, rtol=1e-15)


def test_normals_of_other_samples_streams_and_seeds_are_unrelated() -> None:
    base = np.array([normals(7, 1, sample, 0) for sample in range(2000)]).ravel()
    for other in (
        [normals(8, 1, sample, 0) for sample in range(2000)],
        [normals(7, 2, sample, 0) for sample in range(2000)],
        [normals(7, 1, sample, 1) for sample in range(2000)],
        [normals(7, 1, sample + 1, 0) for sample in range(2000)],
    ):
        correlation = float(np.mean(base * np.array(other).ravel()))
        assert abs(correlation) < 5.0 / math.sqrt(base.size)
