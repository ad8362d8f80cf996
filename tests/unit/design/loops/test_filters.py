"""Filters of autopilots against scipy, and the loops built of them."""

import math

import numpy as np
import pytest
import scipy.signal
from numpy.typing import NDArray

from firmware_model.config.gyro_filters import Biquad, butterworth, notch
from gustproof.design.loops.filters import SampledAxisLoop, smoothing
from gustproof.law.cascade import AxisLaw

RATE = 250.0
OMEGA = np.geomspace(1.0, 0.98 * math.pi * RATE, 60)


def response(filtered: AxisLaw) -> NDArray[np.complex128]:
    """Return gyro to command of a law."""
    return filtered.controller(1.0 / RATE).response(OMEGA)[:, 0, 0]


def law_of(biquad: Biquad) -> AxisLaw:
    """Return the law that filters the gyro."""
    loop = SampledAxisLoop(1.0 / RATE)
    return loop.law(loop.apply_filter(loop.rate, biquad), loop.reference, None, loop.order)


def test_the_low_pass_is_scipys_butterworth() -> None:
    b, a = scipy.signal.butter(2, 40.0, fs=RATE)
    _, H = scipy.signal.freqz(b, a, worN=OMEGA / RATE)
    np.testing.assert_allclose(response(law_of(butterworth(40.0, RATE))), H, rtol=1e-8, atol=1e-12)


def test_the_deepest_notch_is_scipys() -> None:
    b, a = scipy.signal.iirnotch(60.0, 60.0 / 20.0, fs=RATE)
    _, H = scipy.signal.freqz(b, a, worN=OMEGA / RATE)
    np.testing.assert_allclose(
        response(law_of(notch(60.0, math.tan(math.pi * 20.0 / RATE), 0.0, RATE))), H, rtol=1e-8, atol=1e-12
    )


def test_a_shallow_notch_has_its_depth_at_its_frequency() -> None:
    b0, b1, b2, a1, a2 = notch(60.0, 0.2, 0.1, RATE)
    _, H = scipy.signal.freqz([b0, b1, b2], [1.0, a1, a2], worN=[0.0, 2.0 * math.pi * 60.0 / RATE, math.pi])
    np.testing.assert_allclose(np.abs(H), [1.0, 0.1, 1.0], atol=1e-12)


def test_the_first_order_is_the_backward_rule() -> None:
    loop = SampledAxisLoop(1.0 / RATE)
    law = loop.law(loop.smooth(loop.rate, smoothing(30.0, RATE)), loop.reference, None, loop.order)
    z, corner = np.exp(1j * OMEGA / RATE), 2.0 * math.pi * 30.0
    np.testing.assert_allclose(response(law), 1.0 / (1.0 + RATE * (1.0 - 1.0 / z) / corner), rtol=1e-9)


def test_no_corner_is_no_filter() -> None:
    loop = SampledAxisLoop(1.0 / RATE)
    assert smoothing(0.0, RATE) == 1.0
    assert loop.smooth(loop.rate, 1.0) is loop.rate
    assert loop.order == 2


def test_the_attitude_is_that_of_the_sample_before() -> None:
    loop = SampledAxisLoop(1.0 / RATE)
    z = np.exp(1j * OMEGA / RATE)
    attitude = 0.5 / RATE * (z + 1.0) / (z - 1.0)
    law = loop.law(loop.attitude, loop.reference, None, loop.order)
    np.testing.assert_allclose(response(law), attitude / z, rtol=1e-8)


def test_states_beyond_those_there_are_do_nothing() -> None:
    loop = SampledAxisLoop(1.0 / RATE)
    smooth = loop.apply_filter(loop.rate, butterworth(40.0, RATE))
    own, padded = (loop.law(smooth, loop.reference - loop.attitude, 3.0, n) for n in (loop.order, 9))
    np.testing.assert_allclose(response(padded), response(own), rtol=1e-10)
    assert padded.A.shape == (9, 9)
    assert padded.rate_limit is not None
    assert padded.rate_limit.S.shape == (1, 9)


@pytest.mark.parametrize("cutoff", [1.0, 20.0, 100.0])
def test_states_of_a_low_pass_equal_a_steady_signal(cutoff: float) -> None:
    law = law_of(butterworth(cutoff, RATE))
    steady = np.linalg.solve(np.eye(2) - law.A[2:, 2:], law.B[2:, 0])
    np.testing.assert_allclose(steady, 1.0, rtol=1e-9)
