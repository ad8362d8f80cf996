"""Numbers of many flights in one array."""

import pytest

from firmware_model.numerics.soa import aligned_zeros


@pytest.mark.parametrize("size", [1, 8, 333])
def test_aligned_zeros_begin_at_a_cache_line(size: int) -> None:
    zeros = aligned_zeros(size)
    assert zeros.shape == (size,)
    assert (zeros == 0.0).all()
    assert zeros.ctypes.data % 64 == 0
