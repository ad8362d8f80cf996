"""Pack the NamedTuples of floats that kernels compute with into rows of one array, and load them again.

Python hands a compiled function one array in a tenth of the time that it takes to hand over its forty numbers.
"""

from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from firmware_model.compiled import kernel

Row = TypeVar("Row", bound=tuple[float, ...])


def loader(kind: type[Row]) -> Callable[[NDArray[np.float64], int], Row]:
    """Return the kernel `load(array, row) -> kind` that reads the fields of `kind` from `array[row:]`.

    The kernel is written out field by field, because a compiled function can't loop over the fields of a tuple.
    """
    fields = ", ".join(f"array[row + {i}]" for i in range(_width(kind)))
    kernel_: Callable[[NDArray[np.float64], int], Row] = _define(
        f"def load(array, row): return kind({fields})", "load", kind
    )
    return kernel_


def storer(kind: type[Row]) -> Callable[[NDArray[np.float64], int, Row], None]:
    """Return the kernel `store(array, row, value)` that writes the fields of `value` to `array[row:]`."""
    lines = "\n".join(f"    array[row + {i}] = value[{i}]" for i in range(_width(kind)))
    kernel_: Callable[[NDArray[np.float64], int, Row], None] = _define(
        f"def store(array, row, value):\n{lines}", "store", kind
    )
    return kernel_


def starts(kinds: Iterable[type[tuple[float, ...]]]) -> list[int]:
    """Return the row at which each of `kinds` starts when they are packed in order, and the end."""
    return [0, *np.cumsum([_width(kind) for kind in kinds]).tolist()]


def _width(kind: Any) -> int:
    return len(kind._fields)


def _define(source: str, name: str, kind: Any) -> Any:
    namespace: dict[str, Any] = {"kind": kind}
    exec(source, namespace)
    return kernel(namespace[name])
