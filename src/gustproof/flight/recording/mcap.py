"""Read the messages of an untrusted MCAP file.

The file is read from its start, chunk by chunk, without its index; every stated size is only a claim. The size of all
decompressed chunks is bounded by a multiple of the file's own size before the first is decompressed.

References
----------
MCAP format specification, https://mcap.dev/spec, version 0.
"""

import os
import struct
from binascii import crc32
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import IO

from firmware_model.config.files import MIB, TEXT, open_regular

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")  # operation, length
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_CHUNK = struct.Struct("<QQQII")  # start time, end time, decompressed size, checksum, length of the compression's name
_COUNT = struct.Struct("<Q")  # messages
_CHANNEL_OP, _MESSAGE_OP, _CHUNK_OP, _STATISTICS_OP, _END_OP = 0x04, 0x05, 0x06, 0x0B, 0x0F
_LARGEST = TEXT + 4 * MIB  # of a record; writers begin a new chunk at one MiB
_MAX_RATIO = 20  # decompressed size over the file's size; flights have three to six


Message = tuple[str, int, bytes]
"""Topic, log time [ns] and serialised content of a message."""


def messages(path: Path) -> Iterator[Message]:
    """Yield the messages of a file in file order.

    Raises
    ------
    OSError
        If there is no such file, or it can't be read.
    ValueError
        If it is no whole MCAP file, or decompresses to more than its size allows.
    """
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size < 2 * len(_MAGIC) or file.read(len(_MAGIC)) != _MAGIC:
            raise ValueError("not an MCAP file")
        file.seek(-len(_MAGIC), os.SEEK_END)
        if file.read() != _MAGIC:
            raise ValueError("not a whole MCAP file: its end is missing")
        most = _LARGEST + _MAX_RATIO * size
        if (
            sum(_claimed_size(body) for operation, body in _records(file, len(_MAGIC), size) if operation == _CHUNK_OP)
            > most
        ):
            raise ValueError(f"a file of {size:,} bytes that claims to decompress to more than {most / MIB:,.0f} MiB")
        topics: dict[int, str] = {}
        found = 0
        for operation, body in _contents(file, size):
            for message in _message(operation, body, topics):
                found += 1
                yield message
        stated = _find_stated(file, size)
        if stated not in (None, found):
            raise ValueError(f"it is damaged: {found:,} of {stated:,} messages")


def _contents(file: IO[bytes], size: int) -> Iterator[tuple[int, bytes]]:
    """Yield operation and content of each record of the data, those of a chunk in place of it."""
    for operation, body in _records(file, len(_MAGIC), size):
        if operation == _CHUNK_OP:
            records = _decompress(body)
            yield from _records(BytesIO(records), 0, len(records))
        else:
            yield operation, body


def _find_stated(file: IO[bytes], size: int) -> int | None:
    """Return the number of messages that the summary, from here on, states; `None` without one."""
    for operation, body in _records(file, file.tell(), size - len(_MAGIC)):
        if operation == _STATISTICS_OP:
            return int(_COUNT.unpack_from(body)[0])
    return None


def _records(file: IO[bytes], begin: int, size: int) -> Iterator[tuple[int, bytes]]:
    """Yield operation and content of each record from `begin` to the end of data, or to `size`."""
    file.seek(begin)
    operation = -1
    while begin < size and operation != _END_OP:
        operation, length = _HEAD.unpack(file.read(_HEAD.size))
        begin += _HEAD.size + length
        if length > _LARGEST or begin > size:
            raise ValueError(f"a record that claims {length:,} bytes in a file of {size:,}")
        yield operation, file.read(length)


def _claimed_size(chunk: bytes) -> int:
    """Return the decompressed size [bytes] that a chunk claims."""
    claimed: int = _CHUNK.unpack_from(chunk)[2]
    if claimed > _LARGEST:
        raise ValueError(f"a chunk that claims to decompress to {claimed:,} bytes; at most {_LARGEST:,} are allowed")
    return claimed


def _decompress(chunk: bytes) -> bytes:
    """Return the records of a chunk."""
    import pyarrow  # decompresses into a buffer of fixed size

    claimed, (checksum, name_length) = _claimed_size(chunk), _CHUNK.unpack_from(chunk)[3:]
    name = chunk[_CHUNK.size :][:name_length].decode()
    content = chunk[_CHUNK.size + name_length + 8 :]
    records: bytes = pyarrow.decompress(content, claimed, name, asbytes=True) if name else content
    if len(records) != claimed or (checksum and crc32(records) != checksum):
        raise ValueError("a chunk whose size or checksum is wrong")
    return records


def _message(operation: int, body: bytes, topics: dict[int, str]) -> Iterator[Message]:
    """Yield the message of a message record; store the topic of a channel record."""
    if operation == _CHANNEL_OP:
        channel, _, length = struct.unpack_from("<HHI", body)
        topics[channel] = body[8:][:length].decode()
    elif operation == _MESSAGE_OP:
        channel, _, time_ns, _ = _MESSAGE.unpack_from(body)
        yield topics[channel], time_ns, body[_MESSAGE.size :]
