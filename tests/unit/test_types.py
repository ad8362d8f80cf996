"""What is checked once cannot be changed behind the check."""

import numpy as np
import pytest

from gustproof.types import readonly_copy


def test_a_frozen_array_is_a_copy_that_nobody_changes():
    given = np.eye(2)
    kept = readonly_copy("A", given, (2, 2))
    given[0, 0] = 7.0
    assert kept.tolist() == [[1.0, 0.0], [0.0, 1.0]]
    with pytest.raises(ValueError, match="read-only"):
        kept[0, 0] = 7.0


@pytest.mark.parametrize(
    ("value", "message"),
    [([[1.0, 2.0]], r"A has shape \(1, 2\), must be \(2, 2\)"), ([[1.0, np.nan], [0.0, 1.0]], "A has a number that")],
)
def test_what_does_not_fit_is_refused_by_its_name(value, message):
    with pytest.raises(ValueError, match=message):
        readonly_copy("A", value, (2, 2))
