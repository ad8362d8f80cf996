"""Weights at the frequencies that define them."""

import numpy as np
import pytest

from gustproof.robust.lti.weights import constant_weight, first_order_weight


def test_a_constant_weight_has_no_states():
    weight = constant_weight((1.0, 2.0, 3.0))
    assert weight.order == 0
    assert np.array_equal(weight.D, np.diag([1.0, 2.0, 3.0]))


@pytest.mark.parametrize(("low", "high"), [(2.0, 0.5), (0.5, 2.0)])
def test_a_first_order_weight_goes_from_low_to_high_through_its_corner(low, high):
    weight = first_order_weight((low,) * 3, 4.0, (high,) * 3)
    gains = np.abs(weight.response([0.0, 4.0, 1e9])[:, 0, 0])
    assert gains == pytest.approx([low, np.sqrt((low**2 + high**2) / 2.0), high], rel=1e-6)
    assert np.allclose(weight.poles(), -4.0)


def test_an_axis_that_is_the_same_at_all_frequencies_has_no_state():
    weight = first_order_weight((2.0, 0.3, 1.0), 4.0, (0.5, 0.3, 2.0))
    assert weight.order == 2
    assert np.abs(weight.response([0.0, 4.0, 1e9])[:, 1, 1]) == pytest.approx([0.3] * 3, rel=1e-15)


def test_a_corner_must_be_positive():
    with pytest.raises(ValueError, match="corner"):
        first_order_weight((1.0,) * 3, 0.0, (2.0,) * 3)
