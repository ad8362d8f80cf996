import math

import numpy as np
import pytest
from scipy.stats import f, rankdata, spearmanr

from gustproof.studies.campaign.intervals import importance, mean, positive_mean, proportion, quantile, rank_values


def test_shares_are_those_of_clopper_and_pearson():
    # C. J. Clopper, E. S. Pearson 1934 and every table since: 95 % of 8 in 10, 0 in 10, 10 in 10
    assert proportion(8, 10) == pytest.approx((0.8, 0.44390, 0.97479), abs=1e-5)
    assert proportion(0, 10) == pytest.approx((0.0, 0.0, 0.30850), abs=1e-5)
    assert proportion(10, 10) == pytest.approx((1.0, 0.69150, 1.0), abs=1e-5)


def test_a_mean_is_within_student_s_interval():
    # t of 4 degrees of freedom at 97.5 %: 2.776; deviation of 1 .. 5: 1.5811
    assert mean(np.arange(1.0, 6.0)) == pytest.approx((3.0, 3.0 - 1.9633, 3.0 + 1.9633), abs=1e-3)
    assert mean(np.array([2.0])) == (2.0, -math.inf, math.inf)


def test_the_median_of_ten_lies_between_the_second_and_the_ninth():
    # H. A. David, H. N. Nagaraja, Order Statistics: 97.9 % for n = 10, and the next narrower pair falls short
    assert quantile(np.arange(10.0), 0.5) == (4.5, 1.0, 8.0)
    assert quantile(np.arange(6.0), 0.5) == (2.5, 0.0, 5.0)  # 2^-6 = 1.6 % is below 2.5 %, 2^-5 is not
    assert quantile(np.arange(5.0), 0.5) == (2.0, -math.inf, math.inf)


def test_few_runs_do_not_say_how_bad_it_may_get():
    assert quantile(np.arange(20.0), 0.95).high == math.inf
    assert quantile(np.arange(71.0), 0.95).high == math.inf
    assert quantile(np.arange(72.0), 0.95).high == 71.0  # 0.95^72 = 2.49 % is the first below 2.5 %


def test_intervals_of_a_quantile_hold_it_as_often_as_they_say():
    drawn = np.sort(np.random.default_rng(1).exponential(size=(2000, 60)), axis=1)
    true = -math.log(1.0 - 0.9)
    held = sum(found.low <= true <= found.high for found in (quantile(row, 0.9) for row in drawn))
    assert 0.95 - 4.0 * math.sqrt(0.95 * 0.05 / 2000) <= held / 2000  # exact intervals are never too narrow
    assert held < 2000


@pytest.mark.parametrize(("levels", "size"), [(5, 32), (10, 32), (10, 20)])
def test_intervals_of_a_product_of_shares_hold_it_as_often_as_they_say(levels, size):
    drawn = np.prod(np.random.default_rng(2).binomial(size, 0.25, (2000, 16, levels)) / size, axis=2)
    found = [positive_mean(row) for row in drawn]
    held = sum(each.low <= 0.25**levels <= each.high for each in found)
    assert held / 2000 == pytest.approx(0.95, abs=4.0 * math.sqrt(0.95 * 0.05 / 2000))
    assert [each.value for each in found] == [float(np.mean(row)) for row in drawn]
    assert all(each.low <= each.value <= each.high for each in found)


def test_a_product_that_is_0_each_time_has_no_upper_bound():
    assert positive_mean(np.zeros(16)) == (0.0, 0.0, math.inf)
    assert positive_mean(np.array([0.25])) == (0.25, 0.0, math.inf)


@pytest.mark.parametrize("distinct", [1, 7, 10**9])
def test_equal_values_share_their_rank_and_stay_in_order(distinct):
    values = np.random.default_rng(4).integers(0, distinct, 300).astype(float)
    found = rank_values(values)
    np.testing.assert_array_equal(found.ranks, rankdata(values))
    np.testing.assert_array_equal(found.order, sorted(range(300), key=values.__getitem__))


def test_importance_is_the_share_of_the_variance():
    rng = np.random.default_rng(2)
    a, b, c = rng.uniform(-1.0, 1.0, (3, 20_000))
    values = 3.0 * a - b + 0.0 * c  # variances 3, 1/3, 0
    found = [importance(rank_values(delta), values, rank_values(values).ranks) for delta in (a, b, c)]
    assert found[0].first_order == pytest.approx(0.9, abs=0.01)
    assert found[1].first_order == pytest.approx(0.1, abs=0.01)
    assert found[2].first_order <= 2.0 * found[2].noise < 0.01
    # Without dependence the mean squares between and within k bins have a ratio of Fisher's distribution.
    k, n = 32, 20_000
    ratio = (k - 1) * f.ppf(0.95, k - 1, n - k) / (n - k)
    assert found[2].noise == pytest.approx(1.0 - (n - 1) / (n - k) / (1.0 + ratio))
    assert found[0].rank_correlation > 0.9
    assert found[1].rank_correlation < -0.2


def test_rank_correlation_is_spearman_s_where_values_are_equal_too():
    a, b = np.random.default_rng(5).integers(0, 9, (2, 500)).astype(float)
    found = importance(rank_values(a), a + b, rank_values(a + b).ranks)
    assert found.rank_correlation == pytest.approx(spearmanr(a, a + b).statistic, rel=1e-12)


def test_what_does_not_rise_or_fall_is_still_seen():
    a = np.random.default_rng(3).uniform(-1.0, 1.0, 4000)
    found = importance(rank_values(a), a**2, rank_values(a**2).ranks)
    assert abs(found.rank_correlation) < 0.1
    assert found.first_order > 0.9


@pytest.mark.parametrize(("n", "bins"), [(50, 2), (74, 2), (75, 3), (799, 31), (800, 32), (2000, 32)])
def test_a_bin_has_25_runs_and_there_are_32_at_most(n, bins):
    values = np.random.default_rng(6).permutation(n).astype(float)
    found = importance(rank_values(np.arange(float(n))), values, rank_values(values).ranks)
    ratio = (bins - 1) * f.ppf(0.95, bins - 1, n - bins) / (n - bins)
    assert found.noise == pytest.approx(1.0 - (n - 1) / (n - bins) / (1.0 + ratio))


def test_too_few_runs_say_nothing_of_importance():
    values = np.arange(49.0)
    assert importance(rank_values(values), values, rank_values(values).ranks) is None
    assert importance(rank_values(np.arange(100.0)), np.ones(100), np.ones(100)) is None
