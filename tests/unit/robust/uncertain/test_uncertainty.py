"""Blocks of Delta: ranges, normalisation, the matrix."""

import numpy as np
import pytest

from firmware_model.config.spreads import Spread
from gustproof.robust.uncertain.uncertainty import FullBlock, RealBlock, Spreads, columns, delta_matrix, rows

OFF_CENTRE = RealBlock(name="k", low=1.0, high=7.0, nominal=2.0, repeats=2)
FULL = FullBlock(name="F", n_outputs=1, n_inputs=3)


def test_delta_takes_a_parameter_from_low_through_nominal_to_high():
    assert OFF_CENTRE.value([-1.0, 0.0, 1.0]) == pytest.approx([1.0, 2.0, 7.0])
    assert OFF_CENTRE.delta([1.0, 2.0, 7.0]) == pytest.approx([-1.0, 0.0, 1.0])
    assert np.all(np.diff(OFF_CENTRE.value(np.linspace(-1.0, 1.0, 50))) > 0.0)


def test_delta_selects_the_value_that_a_vehicle_files_spread_selects():
    spread = Spread(nominal=2.0, low=1.0, high=7.0)
    assert [spread.value(delta) for delta in (-0.7, 0.3)] == list(OFF_CENTRE.value([-0.7, 0.3]))


def test_a_centred_parameter_is_linear_in_delta():
    centred = RealBlock(name="k", low=-2.0, high=6.0, nominal=2.0)
    assert centred.value(np.array([-0.5, 0.25])) == pytest.approx([0.0, 3.0])


@pytest.mark.parametrize(("low", "high", "nominal"), [(1.0, 2.0, 1.0), (2.0, 1.0, 1.5), (0.0, np.inf, 1.0)])
def test_a_range_without_an_inside_is_refused(low, high, nominal):
    with pytest.raises(ValueError, match="parameter 'k': needs finite low < nominal < high, got"):
        RealBlock(name="k", low=low, high=high, nominal=nominal)


def test_blocks_without_size_are_refused():
    with pytest.raises(ValueError, match="repeated 0 times"):
        RealBlock(name="k", low=0.0, high=2.0, nominal=1.0, repeats=0)
    with pytest.raises(ValueError, match="at least 1 x 1"):
        FullBlock(name="F", n_outputs=0)


def test_delta_repeats_a_number_and_places_a_matrix():
    matrix = delta_matrix((OFF_CENTRE, FULL), {"k": 0.5, "F": [[0.1, 0.2, 0.3]]})
    assert np.array_equal(matrix, [[0.5, 0, 0, 0, 0], [0, 0.5, 0, 0, 0], [0, 0, 0.1, 0.2, 0.3]])
    assert rows((OFF_CENTRE, FULL)) == (slice(0, 2), slice(2, 3))
    assert columns((OFF_CENTRE, FULL)) == (slice(0, 2), slice(2, 5))


def test_a_name_left_out_is_nominal_and_a_wrong_one_is_refused():
    assert not np.any(delta_matrix((OFF_CENTRE, FULL), {}))
    with pytest.raises(ValueError, match="unknown parameter 'x', there are k, F"):
        delta_matrix((OFF_CENTRE, FULL), {"x": 0.0})
    with pytest.raises(ValueError, match="block 'F' has the shape"):
        delta_matrix((OFF_CENTRE, FULL), {"F": [[1.0, 0.0]]})


@pytest.mark.parametrize("value", [-0.1, 1.0, np.nan])
def test_a_spread_that_reaches_zero_is_refused(value):
    with pytest.raises(ValueError, match=r"inertia spread is .*, must be in \[0, 1\)"):
        Spreads(inertia=value)
