"""Names of array types, read-only arrays, checked once on entry, and numbers of JSON."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Records = NDArray[np.void]
"""Records of a flight's journal, see `firmware_model.recording.journal`."""


def readonly_copy(name: str, value: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return a read-only copy of `value`, in C order.

    Raises
    ------
    ValueError
        If it has another shape, text in the place of a number, or a number that is not finite. The message calls it
        `name`.
    """
    given = np.asarray(value)
    if given.dtype.kind in "US":
        raise ValueError(f"{name} has text in the place of a number")
    array = np.array(given, dtype=np.float64, order="C")
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}, must be {shape}")
    if np.count_nonzero(np.isfinite(array)) < array.size:  # twice as fast as `all`, and each system asks
        raise ValueError(f"{name} has a number that is not finite")
    array.flags.writeable = False
    return array


def finite_or_none(value: float | None) -> float | None:
    """Return a number as JSON holds it: `None` for one that is infinite or NaN."""
    return value if value is not None and math.isfinite(value) else None
