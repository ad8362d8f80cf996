"""Paired ratios whose test may be read after each flight: few false verdicts, and real differences soon found."""

import math

import numpy as np
import pytest

from gustproof.studies.campaign.paired import Change, error_ratio, find_change


def run_until_known(difference: float, spread: float, random: np.random.Generator) -> tuple[Change, int]:
    """Return the verdict on errors with a relative difference, and the flights that it took, 60 at most."""
    ratios = np.exp(random.normal(math.log1p(difference), spread, 60))
    for count in range(1, 61):
        change = find_change(error_ratio(ratios[:count].tolist(), [1.0] * count))
        if change is not Change.OPEN:
            break
    return change, count


@pytest.mark.parametrize("spread", [0.01, 0.1])
def test_at_most_two_of_200_null_comparisons_are_flagged(spread: float) -> None:
    random = np.random.default_rng(8)
    found = [run_until_known(0.0, spread, random)[0] for _ in range(200)]
    assert sum(each in (Change.WORSE, Change.BETTER) for each in found) <= 2


@pytest.mark.parametrize(("difference", "change"), [(0.03, Change.WORSE), (-0.03, Change.BETTER)])
def test_three_percent_are_found_in_few_flights(difference: float, change: Change) -> None:
    random = np.random.default_rng(9)
    found = [run_until_known(difference, 0.01, random) for _ in range(50)]
    assert all(each is change for each, _ in found)
    assert float(np.median([count for _, count in found])) < 9


def test_the_interval_holds_the_ratio_at_all_times() -> None:
    random, left = np.random.default_rng(10), 0
    for _ in range(200):
        ratios = np.exp(random.normal(0.05, 0.02, 40))
        ends = [error_ratio(ratios[:n].tolist(), [1.0] * n) for n in range(1, 41)]
        left += any(not low <= math.exp(0.05) <= high for _, low, high in ends)
    assert left <= 4  # 1 % of 200, and chance


def test_one_pair_tells_nothing_and_equal_flights_are_alike_and_units_cancel() -> None:
    assert error_ratio([2.0], [1.0])[1:] == (0.0, math.inf)
    assert find_change(error_ratio([1.0, 2.0, 3.0, 4.0, 5.0], [1.0, 2.0, 3.0, 4.0, 5.0])) is Change.ALIKE
    errors, others = [1.0, 1.1, 1.3, 0.9, 1.2, 1.0], [0.9, 1.0, 1.2, 0.8, 1.1, 0.95]
    scaled = error_ratio([1e3 * each for each in errors], [1e3 * each for each in others])
    assert scaled == pytest.approx(error_ratio(errors, others))
