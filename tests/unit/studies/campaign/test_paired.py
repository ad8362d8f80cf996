"""Paired ratios whose test may be read after each flight: few false verdicts, and real differences soon found."""

import math
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.flight.routes.batch import Case, fly_many
from gustproof.law.form import Law, load_law
from gustproof.studies.campaign.intervals import IntervalEstimate
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


@pytest.mark.parametrize("n", [4, 5, 30])
def test_at_an_end_of_the_interval_the_likelihood_ratio_is_a_hundred(n: int) -> None:
    """Of an effect with a variance of 10 to none, by Student's t (Perez-Ortiz and others, 2024, section 4)."""
    ratios = np.exp(np.random.default_rng(n).normal(0.05, 0.02, n))
    found, spread = error_ratio(ratios.tolist(), [1.0] * n), float(np.std(np.log(ratios), ddof=1))
    assert found.value == pytest.approx(float(np.exp(np.mean(np.log(ratios)))))
    for end in (found.low, found.high):
        t = math.sqrt(n) * math.log(found.value / end) / spread
        growth, share = 1.0 + 10.0 * n, t * t / (n - 1)
        evidence = growth**-0.5 * ((1.0 + share) / (1.0 + share / growth)) ** (n / 2)
        assert evidence == pytest.approx(100.0)


@pytest.mark.parametrize(("count", "is_bounded"), [(3, False), (4, True)])
def test_four_pairs_bound_a_ratio_and_equal_ones_have_a_spread_of_a_billionth(count: int, is_bounded: bool) -> None:
    found = error_ratio([2.0] * count, [1.0] * count)
    assert (found.low, found.high) == pytest.approx((2.0, 2.0), abs=1e-6) if is_bounded else (0.0, math.inf)
    if is_bounded:
        assert 1e-8 < found.high - found.low < 3e-7


@pytest.mark.parametrize(
    ("low", "high", "change"),
    [
        (0.991, 1.009, Change.ALIKE),
        (0.991, 0.999, Change.ALIKE),
        (0.989, 1.009, Change.OPEN),
        (0.991, 1.011, Change.OPEN),
        (0.9, 0.999, Change.BETTER),
        (0.9, 1.0, Change.OPEN),
        (1.001, 1.1, Change.WORSE),
        (1.0, 1.1, Change.OPEN),
    ],
)
def test_an_error_is_less_more_or_alike_within_a_hundredth(low: float, high: float, change: Change) -> None:
    assert find_change(IntervalEstimate(1.0, low, high)) is change


SHORT, PAPER = replace(load_scenario("paper-turbulence"), duration_s=2.0), load_vehicle("paper")


def fly_errors(law: Law, seeds: range, duration_s: float = 2.0) -> list[float]:
    """Return the rms error [deg] of a law with each seed."""
    scenario = replace(SHORT, duration_s=duration_s)
    return [each.metrics.rmse_deg for each in fly_many(scenario, law, [Case(vehicle=PAPER, seed=k) for k in seeds])]


def through(law: Law, new: float) -> Law:
    """Return the law behind a first-order filter that takes a share [-] of each new command; a sample late for 0."""
    n, kept = law.order, 1.0 - new
    first, fed = (1.0, 0.0) if new == 0.0 else (new, kept)
    A = np.block([[law.A, np.zeros((n, 3))], [first * law.C, fed * np.eye(3)]])
    C = np.hstack([new * law.C, (1.0 if new == 0.0 else kept) * np.eye(3)])
    G, H = (np.vstack([each, np.zeros((3, 3))]) for each in (law.G, law.H))
    return replace(law, A=A, B=np.vstack([law.B, first * law.D]), C=C, D=new * law.D, G=G, H=H, rate_limit=None)


@pytest.mark.parametrize("kind", ["gain", "filter", "delay"])
def test_a_law_made_worse_is_found_in_few_flights(kind: str) -> None:
    law = load_law("flagship")
    made = {
        "gain": replace(law, C=0.97 * law.C, D=0.97 * law.D),
        "filter": through(law, 1.0 - math.exp(-2.0 * math.pi * 30.0 * law.dt)),
        "delay": through(law, 0.0),
    }[kind]
    errors, before = fly_errors(made, range(1, 21), 6.0), fly_errors(law, range(1, 21), 6.0)
    found = [find_change(error_ratio(errors[:count], before[:count])) for count in range(4, 21)]
    assert Change.WORSE in found
    assert Change.BETTER not in found
    assert error_ratio(errors, before).value < 1.05
    through_all = fly_errors(replace(law, rate_limit=None), range(1, 5), 6.0)
    assert through_all == before[:4]  # what `through` leaves out does not act here


def test_flown_null_comparisons_are_flagged_in_a_hundredth_at_most() -> None:
    """Compare a law with itself in other gusts, 800 times."""
    errors = np.array(fly_errors(load_law("flagship"), range(1000, 9000)))
    flagged = 0
    for turn in range(4):
        pairs = np.random.default_rng(turn).permutation(errors).reshape(200, 2, 20)
        for mine, its in pairs.tolist():
            verdicts = (find_change(error_ratio(mine[:count], its[:count])) for count in range(4, 21))
            flagged += next((each for each in verdicts if each is not Change.OPEN), None) in (
                Change.WORSE,
                Change.BETTER,
            )
    assert flagged <= 8
