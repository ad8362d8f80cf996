import numpy as np
import pytest

from gustproof.logs.read.stamps import find_chain, usual_step

BESIDE = pytest.mark.parametrize(("times", "beyond"), [(0.96, False), (1.04, True)])
"""A share of a threshold, and whether it is beyond."""


@BESIDE
def test_stamps_within_reach_of_the_chain_are_on_it(times, beyond):
    assert usual_step(np.cumsum([0.0, *[1.0] * 100, 30.0 * times])) == pytest.approx(
        1.0 if beyond else 1.2752, abs=1e-3
    )
    even = np.arange(2000.0) * 2000.0
    late = np.append(even, even[-1] + 1e6 * times)  # the last alone
    assert find_chain(late).tolist() == [*[True] * 2000, not beyond]
    twice = np.concatenate([even[:5], even[4:]])  # what follows a wrong stamp is looked at
    for steps in (3.0 * times, 1.5 * times):
        burst = np.cumsum(np.where(np.arange(2001) % 5 == 0, 4.0 * 2000.0, 2000.0)) if steps < 2.0 else twice
        burst[5] = burst[4]
        reach = steps * (4.0 * 2000.0 if steps < 2.0 else 2000.0)
        assert bool(find_chain(np.append(burst, burst[-1] + reach))[-1]) is not beyond
    pause = np.concatenate([even, even + even[-1] + 600e6 * times])
    assert find_chain(pause).sum() == (2000 if beyond else 4000)


@pytest.mark.parametrize("last", [16, 17])
def test_a_step_that_stays_is_believed_of_seventeen_samples(last):
    even = np.arange(2000.0) * 2000.0
    stepped = np.where(np.arange(2000) < 2000 - last, even, even + 40e6)
    assert find_chain(stepped).sum() == (2000 if last == 17 else 2000 - last)


@BESIDE
def test_pieces_overlap_by_eight_samples(times, beyond):
    even = np.arange(2000.0) * 2000.0
    back = np.where(np.arange(2000) < 1200, even, even - 2000.0 * (8.0 * times + 1.0))
    assert (find_chain(back).sum() > 1300) is not beyond
