import math

import numpy as np
import pytest

from gustproof.studies.league.ranking import CLIP, OperatingPoint, classify, compute_standings, log_ratios


def scores_of(*means: float, cells: int = 5, runs: int = 8, scatter: float = 0.01) -> np.ndarray:
    """Return scores of entries whose true means are known, with a scatter in common and one of their own."""
    generator = np.random.default_rng(1)
    shared = generator.normal(0.0, 0.2, (1, cells, runs))
    own = generator.normal(0.0, scatter, (len(means), cells, runs))
    return np.array(means)[:, None, None] + shared + own


def test_entrys_that_differ_by_more_than_their_scatter_have_ranks_of_their_own() -> None:
    found = compute_standings(scores_of(math.log(0.8), 0.0, math.log(1.2)))
    assert found.ranks(range(3)) == [1, 2, 3]
    assert found.pairs[0][1].value == pytest.approx(0.8, rel=0.02)
    assert found.pairs[0][1].low < found.pairs[0][1].value < found.pairs[0][1].high < 1.0
    assert found.pairs[1][0].low == pytest.approx(1.0 / found.pairs[0][1].high)


def test_entrys_that_cannot_be_told_apart_share_a_rank() -> None:
    found = compute_standings(scores_of(0.0, 0.0005, 1.0, scatter=0.1))
    assert found.ranks(range(3)) == [1, 1, 3]
    assert found.ranks([1, 2]) == [1, 2]


def test_pairs_are_sharper_than_scores_as_all_fly_the_same_seeds() -> None:
    found = compute_standings(scores_of(0.0, 0.02))
    assert math.log(found.pairs[0][1].high / found.pairs[0][1].low) < 0.2 * math.log(
        found.ratios[0].high / found.ratios[0].low
    )


def test_interval_holds_the_truth_in_nineteen_of_twenty_leagues() -> None:
    generator, held = np.random.default_rng(2), 0
    for _ in range(80):
        scores = generator.normal(0.0, 0.1, (1, 4, 4))
        estimate = compute_standings(scores).ratios[0]
        held += estimate.low <= 1.0 <= estimate.high
    assert 70 <= held <= 79


def test_single_flight_bounds_nothing() -> None:
    found = compute_standings(scores_of(0.0, 1.0, runs=1))
    assert (found.ratios[0].low, found.ratios[0].high, found.ranks(range(2))) == (0.0, math.inf, [1, 1])


def test_failed_flight_counts_as_the_worst_and_no_flight_counts_beyond_the_clip() -> None:
    reference = np.array([[30.0, 0.1]])
    scores = log_ratios(np.array([[[math.nan, math.nan]], [[1e9, 1e-9]]]), reference)
    assert np.exp(scores[0, 0]) == pytest.approx([2.0, CLIP])
    assert np.exp(scores[1, 0]) == pytest.approx([2.0, 1.0 / CLIP])


MEASURED = {"Ms": 1.39, "gain_margin": 3.5, "delay_margin_s": 0.02, "slew": 20.0}


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({}, "robust"),
        ({"Ms": 1.44}, "robust"),
        ({"Ms": 1.45}, "usual"),
        ({"gain_margin": None, "delay_margin_s": None}, "robust"),
        ({"delay_margin_s": 0.009}, "usual"),
        ({"slew": 50.0}, "sharp"),
        ({"gain_margin": 1.5}, "open"),
        ({"refused": "the loop does not settle"}, "open"),
    ],
)
def test_class_is_the_first_whose_bounds_hold_on_all_vehicles(changes: dict, name: str) -> None:
    assert classify([OperatingPoint.parse({**MEASURED, **each}, 20.0) for each in ({}, changes)]) == name
