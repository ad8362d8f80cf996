"""Frequency responses of short series."""

import numpy as np
import pytest

from gustproof.logs.identify.spectra import frequency_response


@pytest.mark.parametrize(("more", "counts"), [(0, False), (1, False), (3, False), (4, True)])
def test_a_segment_counts_only_whole(more, counts):
    """Segments of 8 samples begin every 4, and none ends beyond its series."""
    command, rate = np.random.default_rng(1).standard_normal((2, 20))
    first = (command[:8], rate[:8], None)
    found, alone = (
        frequency_response([first, (command[8 : 16 + n], rate[8 : 16 + n], None)], 0.1, 5.0) for n in (more, 0)
    )
    assert np.array_equal(found.response, alone.response) != counts
