import numpy as np
import pytest

from gustproof.studies.campaign.sampling import _CASES, Sampling, _key, draw_deltas, draw_normals, flight_seeds, permute

CASES, WIDTH = 256, 5


def all_of(sampling, seed=3, cases=CASES, width=WIDTH):
    return draw_deltas(sampling, seed, cases, width, 0, cases)


@pytest.mark.parametrize("sampling", Sampling)
def test_any_stretch_can_be_drawn_alone(sampling):
    whole = all_of(sampling)
    parts = [draw_deltas(sampling, 3, CASES, WIDTH, first, count) for first, count in ((0, 3), (3, 97), (100, 156))]
    assert np.array_equal(np.vstack(parts), whole)


def test_the_draws_of_tables_that_are_written_stay():
    """A run is flown again from seed and number alone, by a later version too."""
    drawn = [draw_deltas(kind, 3, 100, 5, 40, 1)[0, 4] for kind in Sampling]
    assert drawn == pytest.approx([-0.0035553891686813, -0.0014813345974533, -0.2700355538916868, -0.045014725998044])
    assert (flight_seeds(5, 7, 1), draw_normals(3, 5, 40, 1)[0, 4]) == ([1608096995], pytest.approx(-0.0044560342554))


@pytest.mark.parametrize("sampling", Sampling)
def test_deltas_fill_their_range_and_depend_on_the_seed(sampling):
    drawn = all_of(sampling)
    assert np.all(np.abs(drawn) <= 1.0)
    assert np.all(drawn.max(axis=0) > 0.6)
    assert np.all(drawn.min(axis=0) < -0.6)
    assert not np.any(drawn == all_of(sampling, seed=4))


def test_uniform_deltas_do_not_depend_on_how_many_there_are():
    assert np.array_equal(draw_deltas(Sampling.UNIFORM, 3, 10**6, WIDTH, 0, CASES), all_of(Sampling.UNIFORM))


def test_uniform_deltas_are_those_of_their_place_in_the_stream():
    drawn = draw_deltas(Sampling.UNIFORM, 3, 10, 4, 7, 1)[0]
    stream = np.random.Generator(np.random.Philox(key=_key(3, _CASES, 4)[:2])).random(32)  # four for a case
    assert drawn == pytest.approx(2.0 * stream[28:] - 1.0, abs=1e-15)


def test_normal_deltas_have_their_deviation():
    drawn = all_of(Sampling.NORMAL, cases=40_000, width=1)
    # a normal of 1/3 cut off at 3 deviations has .9865 of it; four standard errors of 40,000 draws
    assert np.std(drawn) == pytest.approx(0.9865 / 3.0, rel=4.0 / np.sqrt(2.0 * 40_000))
    assert np.mean(drawn) == pytest.approx(0.0, abs=4.0 / 3.0 / np.sqrt(40_000))


def test_a_uniform_number_of_zero_has_a_finite_place(monkeypatch):
    monkeypatch.setattr("gustproof.studies.campaign.sampling._draw_uniform", lambda *_: np.array([[0.0, 0.5]]))
    assert draw_normals(3, 2, 0, 1)[0] == pytest.approx((-8.21, 0.0), abs=0.01)  # the quantile of 2^-53


@pytest.mark.parametrize("cases", [1, 7, 256, 1000])
def test_a_latin_hypercube_has_one_case_in_each_part_of_each_range(cases):
    drawn = all_of(Sampling.LATIN, cases=cases)
    strata = np.floor((drawn + 1.0) / 2.0 * cases).astype(int)
    assert np.array_equal(np.sort(strata, axis=0), np.repeat(np.arange(cases)[:, None], WIDTH, axis=1))


def test_the_columns_of_a_latin_hypercube_are_not_alike():
    correlation = np.corrcoef(all_of(Sampling.LATIN, cases=4096).T)
    assert np.max(np.abs(correlation - np.eye(WIDTH))) < 5.0 / np.sqrt(4096)


def test_sobol_points_are_even_in_two_dimensions_at_once():
    quarter = (all_of(Sampling.SOBOL)[:, :2] > 0.0) @ np.array([2, 1])
    assert np.bincount(quarter).tolist() == [CASES // 4] * 4


@pytest.mark.parametrize("n", [1, 2, 3, 64, 65, 1000])
def test_a_permutation_puts_each_number_in_its_own_place(n):
    key = np.arange(11, 17, dtype=np.uint64)
    placed = permute(np.arange(n, dtype=np.uint64), n, key)
    assert sorted(placed.tolist()) == list(range(n))


def test_each_case_has_gusts_and_noise_of_its_own():
    seeds = flight_seeds(5, 0, 1000)
    assert len(set(seeds)) == 1000
    assert flight_seeds(5, 400, 3) == seeds[400:403]
    assert not set(seeds) & set(flight_seeds(6, 0, 1000))
    assert all(0 <= seed < 2**32 for seed in seeds)
