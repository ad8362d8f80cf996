"""Read numbers and texts of a MATLAB file of level 5 (versions 5 to 7.2), which may come from anywhere.

scipy's reader is not made for hostile files: a few wrong bytes end the process. Here each size is compared with what is
there before it is used, and nothing but the variables that are asked for is read.

References
----------
The MathWorks, "MAT-File Format", R2023b: "MAT-File Level 5 File Format", tables 1-1 to 1-3 and "Level 5 Data Elements".
"""

import math
import struct
import zlib
from collections.abc import Collection, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.files import TEXT

_HEADER, _TAG = 128, 8  # [bytes]
_ORDERS = {b"IM": "<", b"MI": ">"}  # of the bytes of a number, by the last two bytes of the header
_LEVEL = 0x0100
_NAME, _DIMENSIONS, _FLAGS, _MATRIX, _COMPRESSED = 1, 5, 6, 14, 15  # types of elements
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_TEXTS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_CHAR, _OPAQUE = 4, 17
_NUMERIC_CLASSES = range(6, 16)  # double to uint64
_CLASSES = {1: "cell", 2: "struct", 3: "object", 5: "sparse", 16: "function", _OPAQUE: "string or object"}
_COMPLEX = 0x0800  # flag of a matrix


class _Element(NamedTuple):
    """A typed piece of the file."""

    kind: int
    """Type: one of the numbers above."""
    content: bytes
    """Its bytes."""


def read_mat(content: bytes, names: Collection[str]) -> dict[str, NDArray[np.float64] | str]:
    """Return the variables of some names: numbers as (rows, columns) in any unit, a row of characters as text.

    Raises
    ------
    ValueError
        If it is no such file, is damaged, or decompresses to more than a file may have. If one of these variables is
        complex, has more than two dimensions, is neither numbers nor a text, or stands there twice.
    """
    order = _ORDERS.get(content[_HEADER - 2 : _HEADER], "")
    if not order or struct.unpack_from(f"{order}H", content, _HEADER - 4) != (_LEVEL,):
        raise ValueError("its first 128 bytes are no header of level 5")
    found: dict[str, NDArray[np.float64] | str] = {}
    for element in _unpack(content[_HEADER:], order):
        if element.kind != _MATRIX:
            continue
        name, flags, parts = _begin_matrix(element.content, order)
        if name in found:
            raise ValueError(f"{name} stands there twice")
        if name in names:
            found[name] = _read_matrix(name, flags, parts, order)
    return found


def _unpack(content: bytes, order: str) -> Iterator[_Element]:
    """Yield the elements of a file, decompressed."""
    left = TEXT
    for element in _split(content, order, padded=False):
        if element.kind != _COMPRESSED:
            yield element
            continue
        stream = zlib.decompressobj()
        try:
            unpacked = stream.decompress(element.content, left)
        except zlib.error as error:
            raise ValueError(str(error)) from None
        left -= len(unpacked)
        if left <= 0:
            raise ValueError(f"it decompresses to more than {TEXT:,} bytes")
        if not stream.eof:
            raise ValueError("a compressed variable is cut off")
        yield from _split(unpacked, order)


def _split(content: bytes, order: str, *, padded: bool = True) -> Iterator[_Element]:
    """Yield the elements of some bytes; each begins at a multiple of 8 unless it is compressed and not `padded`."""
    at = 0
    while at < len(content):
        if at + _TAG > len(content):
            raise ValueError("it ends within the tag of an element")
        kind, size = struct.unpack_from(f"{order}II", content, at)
        if kind >> 16:  # small: the size stands in the upper half, up to four bytes in place of the size
            kind, size, begin, end = kind & 0xFFFF, kind >> 16, at + 4, at + _TAG
            if size > _TAG - 4:
                raise ValueError(f"a small element has {size} bytes")
        else:
            begin = at + _TAG
            end = begin + size + (-size % 8 if padded or kind != _COMPRESSED else 0)
        if begin + size > len(content):
            raise ValueError(f"an element has {size:,} bytes, and {len(content) - begin:,} are there")
        yield _Element(kind, content[begin : begin + size])
        at = end


def _begin_matrix(content: bytes, order: str) -> tuple[str, int, Iterator[_Element]]:
    """Return the name of a matrix, its flags, and its other elements from the dimensions on."""
    parts = _split(content, order)
    flags = next(parts, None)
    if flags is None or flags.kind != _FLAGS or len(flags.content) < 4:
        raise ValueError("a variable has no flags")
    number: int = struct.unpack_from(f"{order}I", flags.content)[0]
    shape = _Element(_DIMENSIONS, b"") if number & 0xFF == _OPAQUE else next(parts, None)
    name = next(parts, None)
    if shape is None or name is None or name.kind != _NAME:
        raise ValueError("a variable has no name")

    def rest() -> Iterator[_Element]:
        yield shape
        yield from parts

    return name.content.decode("latin-1"), number, rest()


def _read_matrix(name: str, flags: int, parts: Iterator[_Element], order: str) -> NDArray[np.float64] | str:
    kind = flags & 0xFF
    if kind != _CHAR and kind not in _NUMERIC_CLASSES:
        raise ValueError(f"{name} is a {_CLASSES.get(kind, f'class {kind}')}, must be numbers or characters")
    if flags & _COMPLEX:
        raise ValueError(f"{name} is complex")
    rows, columns = _read_shape(name, next(parts), order)
    data = next(parts, _Element(2, b""))
    if kind == _CHAR:
        return _read_text(name, (rows, columns), data, order)
    if data.kind not in _NUMBERS:
        raise ValueError(f"{name} has data of type {data.kind}")
    number = np.dtype(f"{order}{_NUMBERS[data.kind]}")
    if len(data.content) != math.prod((rows, columns, number.itemsize)):
        raise ValueError(f"{name} is {rows} x {columns}, with {len(data.content):,} bytes of {number.name}")
    values = np.frombuffer(data.content, number).astype(np.float64)
    return np.ascontiguousarray(values.reshape((rows, columns), order="F"))


def _read_shape(name: str, shape: _Element, order: str) -> tuple[int, int]:
    if shape.kind != _DIMENSIONS or len(shape.content) != 8:
        raise ValueError(f"{name} has not two dimensions")
    rows, columns = struct.unpack(f"{order}ii", shape.content)
    if rows < 0 or columns < 0 or rows * columns * 8 > TEXT:
        raise ValueError(f"{name} is {rows} x {columns}")
    return rows, columns


def _read_text(name: str, shape: tuple[int, int], data: _Element, order: str) -> str:
    if min(shape) > 1 or data.kind not in _TEXTS:
        raise ValueError(f"{name} is {shape[0]} x {shape[1]} of characters, must be one row of text")
    code = _TEXTS[data.kind]
    suffix = {"<": "-le", ">": "-be"}[order] if code in ("utf-16", "utf-32") else ""
    text = data.content.decode(f"{code}{suffix}")  # of damaged bytes a UnicodeDecodeError, which is a ValueError
    if len(text) > math.prod(shape):
        raise ValueError(f"{name} is {shape[0]} x {shape[1]}, with {len(text)} characters")
    return text
