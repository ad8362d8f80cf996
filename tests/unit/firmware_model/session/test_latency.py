import numpy as np
import pytest

from firmware_model.session.latency import Latency


def told(delays) -> Latency:
    lateness = Latency()
    for late_us in delays:
        lateness.add(int(late_us))
    return lateness


@pytest.mark.parametrize("percent", [1.0, 50.0, 90.0, 99.0, 99.9, 100.0])
def test_percentiles_are_those_of_the_sorted_delays(percent):
    delays = np.random.default_rng(5).exponential(300.0, 5_000).astype(int)
    expected = np.percentile(delays, percent, method="inverted_cdf")
    assert told(delays).percentile_us(percent) == expected


def test_figures_are_median_99_percent_and_worst():
    assert told([*range(1, 100), 4_000]).stats() == {"p50_us": 50, "p99_us": 99, "worst_us": 4_000}


def test_nothing_flown_is_late_by_nothing():
    assert Latency().stats() == {"p50_us": 0, "p99_us": 0, "worst_us": 0}


def test_what_is_very_late_is_told_as_the_worst_and_fills_no_memory():
    lateness = told(range(0, 10_000_000, 1_000))
    assert len(lateness._counts) <= 21
    assert lateness.stats() == {"p50_us": 9_999_000, "p99_us": 9_999_000, "worst_us": 9_999_000}
    assert lateness.percentile_us(0.1) == 9_000
