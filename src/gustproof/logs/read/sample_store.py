"""Read a binary log block by block, and keep the records that are wanted: memory is bounded, whatever the file says."""

import os
from array import array
from collections.abc import Callable, Hashable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.files import MIB, open_regular

_BLOCK = 4 * MIB
_LARGEST = 4096 * MIB
_KEPT = 256 * MIB
_RECORD = 24  # [bytes] of bookkeeping that a record takes


def read_blocks(path: Path, consume: Callable[[bytes, int], int]) -> int:
    """Pass a file to `consume(buffer, place)` in blocks, and return the bytes at its end that it did not consume.

    `buffer` begins at `place` in the file. `consume` returns how many bytes of whole messages it has taken; the others
    come again, with more behind them.

    Raises
    ------
    OSError
        If the file can't be read.
    ValueError
        If it is too large to be read in minutes.
    """
    buffer, place = b"", 0
    with open_regular(path) as file:
        if os.fstat(file.fileno()).st_size > _LARGEST:
            raise ValueError(f"is larger than {_LARGEST // MIB:,} MiB")
        while block := file.read(_BLOCK):
            buffer += block
            used = consume(buffer, place)
            buffer, place = buffer[used:], place + used
    return len(buffer)


class SampleStore:
    """Records that are kept, by key; together they are bounded.

    Raises
    ------
    ValueError
        If there are too many.
    """

    def __init__(self) -> None:
        self._content: dict[Hashable, bytearray] = {}
        self._places: dict[Hashable, array[int]] = {}
        self._left = _KEPT

    def add(self, key: Hashable, place: int, record: bytes) -> None:
        """Keep a record that stands at `place` in the file; all records of a key are equally long."""
        self._left -= len(record) + _RECORD
        if self._left < 0:
            raise ValueError(f"it holds more than {_KEPT // MIB} MiB of the signals that are used: cut it")
        if key not in self._content:
            self._content[key], self._places[key] = bytearray(), array("q")
        self._content[key] += record
        self._places[key].append(place)

    def __contains__(self, key: Hashable) -> bool:
        return key in self._content

    def table(self, key: Hashable, layout: np.dtype[np.void]) -> tuple[NDArray[np.int64], NDArray[np.void]]:
        """Return places and records (n,) of a key."""
        places = np.frombuffer(self._places.get(key, array("q")), dtype=np.int64)
        return places, np.frombuffer(self._content.get(key, b""), dtype=layout, count=len(places))
