"""MATLAB files from scipy, by hand, and damaged: numbers and texts come back, or one `ValueError` says why not."""

import base64
import io
import struct
import warnings
import zlib

import numpy as np
import pytest
import scipy.io

from firmware_model.config.files import TEXT
from gustproof.law.write.mat_file import read_mat

SEGFAULT = zlib.decompress(
    base64.b64decode(
        b"eNrzdQzxcXRSMNUzUPB1DNFNy8xJVQjISSxJyy/KtVIoyC/OrNBRcC5KTSxJTVHIz7NSCE4sUfDLL1MwslAwsLQytLQyMlYw"
        b"MjAyY2BgYGQgETB6+vIBqQ0sDAxsQJqDAUKDACuUzwPFjEDoiGQBJxA3sMB4H+yJtfIdgilzZuqCztvz96MrEWmr4p72leEA"
        b"foOwW4nkI31RiBAhnyEBAO3VJQs="
    )
)
"""A file of 397 bytes that ends a process in which `scipy.io.loadmat` 1.17 reads it."""


def saved(content, **options) -> bytes:
    file = io.BytesIO()
    scipy.io.savemat(file, content, **options)
    return file.getvalue()


def element(kind: int, content: bytes, order: str = "<") -> bytes:
    return struct.pack(f"{order}II", kind, len(content)) + content + bytes(-len(content) % 8)


def matrix(name: str, shape, data: bytes, order: str = "<", kind: int = 6, flags: int = 0) -> bytes:
    parts = (
        element(6, struct.pack(f"{order}II", flags << 8 | kind, 0), order),
        element(5, struct.pack(f"{order}{len(shape)}i", *shape), order),
        element(1, name.encode(), order),
        data,
    )
    return element(14, b"".join(parts), order)


def file_of(*elements: bytes, order: str = "<") -> bytes:
    return bytes(124) + struct.pack(f"{order}H", 0x0100) + {"<": b"IM", ">": b"MI"}[order] + b"".join(elements)


def packed(content: bytes) -> bytes:
    return struct.pack("<II", 15, len(content)) + content


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("kind", ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "?"])
def test_numbers_that_scipy_writes_come_back_to_the_bit(kind, compressed):
    rng = np.random.default_rng(1)
    for shape in ((1, 1), (3, 2), (2, 9), (0, 3), (1, 300)):
        values = rng.integers(0, 100, shape).astype(kind) if kind[0] in "iu?" else rng.normal(size=shape).astype(kind)
        content = saved({"before": np.eye(2), "A": values, "after": "x"}, do_compression=compressed)
        read = read_mat(content, ("A",))
        assert list(read) == ["A"]
        assert read["A"].shape == shape
        assert read["A"].tobytes() == values.astype(np.float64).tobytes()


@pytest.mark.parametrize("text", ["hinf-d1", "x", "", "Bö, 风", '{"a": 1}' * 50])
def test_a_text_that_scipy_writes_comes_back(text):
    assert read_mat(saved({"name": text}), ("name",)) == {"name": text}


@pytest.mark.parametrize("order", ["<", ">"])
def test_files_of_matlab_on_either_kind_of_machine_are_read(order):
    # MATLAB keeps whole doubles as small integers, and texts as UTF-16
    small = struct.pack(f"{order}I", 4 << 16 | 1) + bytes([1, 2, 255, 4])
    text = element(4 if order == "<" else 17, "dt 1".encode("utf-16-le" if order == "<" else "utf-16-be"), order)
    content = file_of(matrix("A", (2, 2), small, order), matrix("t", (1, 4), text, order, kind=4), order=order)
    read = read_mat(content, ("A", "t"))
    assert read["A"].tolist() == [[1.0, -1.0], [2.0, 4.0]]
    assert read["t"] == "dt 1"


ONE = element(9, struct.pack("<d", 1.0))


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"", "no header"),
        (bytes(200), "no header"),
        (file_of(b"1234"), "within the tag"),
        (file_of(struct.pack("<II", 14, 1 << 31)), "2,147,483,648 bytes, and 0 are there"),
        (file_of(struct.pack("<II", 5 << 16 | 1, 0)), "small element has 5"),
        (file_of(element(14, b"")), "no flags"),
        (file_of(element(14, element(6, bytes(8)))), "no name"),
        (file_of(matrix("A", (1, 1), ONE), matrix("A", (1, 1), ONE)), "A stands there twice"),
        (file_of(matrix("A", (2, 1), ONE)), "A is 2 x 1, with 8 bytes of float64"),
        (file_of(matrix("A", (-1, -1), ONE)), "A is -1 x -1"),
        (file_of(matrix("A", (1 << 30, 1 << 30), ONE)), "A is 1073741824 x 1073741824"),
        (file_of(matrix("A", (1, 1, 1), ONE)), "not two dimensions"),
        (file_of(matrix("A", (1, 1), b"")), "with 0 bytes"),
        (file_of(matrix("A", (1, 1), element(14, b""))), "data of type 14"),
        (file_of(matrix("A", (1, 1), ONE, flags=8)), "A is complex"),
        (file_of(matrix("A", (2, 2), element(4, b"abcdefgh"), kind=4)), "one row of text"),
        (file_of(matrix("A", (1, 1), element(16, b"ab"), kind=4)), "with 2 characters"),
        (file_of(matrix("A", (1, 2), element(16, b"\xff\xfe"), kind=4)), "codec"),
        (file_of(matrix("A", (1, 1), ONE, kind=1)), "A is a cell"),
        (file_of(matrix("A", (1, 1), ONE, kind=2)), "A is a struct"),
        (file_of(matrix("A", (1, 1), ONE, kind=5)), "A is a sparse"),
        (file_of(matrix("A", (1, 1), ONE, kind=16)), "A is a function"),
        (file_of(matrix("A", (1, 1), ONE, kind=99)), "A is a class 99"),
        (file_of(packed(b"nothing")), "Error -3"),
        (file_of(packed(zlib.compress(matrix("A", (1, 1), ONE))[:-3])), "cut off"),
        (file_of(packed(zlib.compress(bytes(TEXT + 1), 9))), "decompresses to more"),
        (file_of(*[packed(zlib.compress(element(1, bytes(TEXT // 4 - 8)), 9))] * 5), "decompresses to more"),
    ],
)
def test_what_is_no_matrix_or_text_is_told(content, complaint):
    with pytest.raises(ValueError, match=complaint):
        read_mat(content, ("A",))


def test_objects_beside_what_is_asked_for_are_passed_over():
    # a string of MATLAB has no dimensions before its name
    opaque = element(14, element(6, struct.pack("<II", 17, 0)) + element(1, b"s") + element(1, b"MCOS"))
    assert read_mat(file_of(opaque, matrix("A", (1, 1), ONE)), ("A",))["A"].tolist() == [[1.0]]
    with pytest.raises(ValueError, match="s is a string or object"):
        read_mat(file_of(opaque), ("s",))


def test_the_file_that_ends_a_process_in_scipy_is_refused():
    assert len(SEGFAULT) == 397
    with pytest.raises(ValueError, match="an element has 1,200 bytes, and 261 are there"):
        read_mat(SEGFAULT, ("A", "B", "C", "D", "dt"))


@pytest.mark.parametrize("compressed", [False, True])
def test_no_flipped_bit_and_no_cut_raises_anything_else(compressed):
    content = saved({"A": np.eye(3), "name": "mine", "dt": 0.004}, do_compression=compressed)
    cases = [content[:n] for n in range(len(content))]
    for i in range(120, len(content)):
        cases += [content[:i] + bytes([content[i] ^ 1 << bit]) + content[i + 1 :] for bit in range(8)]
    refused = 0
    with warnings.catch_warnings(action="error"):
        for case in cases:
            try:
                read = read_mat(case, ("A", "name", "dt"))
            except ValueError:
                refused += 1
            else:
                assert set(read) <= {"A", "name", "dt"}
    assert refused > 0.3 * len(cases)
