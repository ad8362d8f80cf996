"""The messages of an MCAP file that may come from anywhere.

It is read from its begin, chunk by chunk, and its index is not believed: no size that it states is more than a claim.
What chunks unfold to is bounded before the first is unfolded, by a multiple of the file's own size.

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
from typing import IO, NamedTuple

from firmware_model.config.files import MIB, TEXT, open_regular

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")  # operation, length
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_CHUNK = struct.Struct("<QQQII")  # start time, end time, size unfolded, checksum, length of the compression's name
_CHANNEL_OP, _MESSAGE_OP, _CHUNK_OP, _END_OP = 0x04, 0x05, 0x06, 0x0F
_LARGEST = TEXT + 4 * MIB  # of a record; writers begin a new chunk at one MiB
_UNFOLDS = 20  # times the file's size; flights do three to six times


class Message(NamedTuple):
    """A message of a topic."""

    topic: str
    """Topic."""
    time_ns: int
    """[ns] when it was logged."""
    payload: bytes
    """What it says, serialised."""


def messages(path: Path) -> Iterator[Message]:
    """Yield the messages of a file in the order in which they stand there.

    Raises
    ------
    OSError
        If there is no such file, or it can't be read.
    ValueError
        If it is no whole MCAP file, or unfolds to more than its size allows.
    """
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size < 2 * len(_MAGIC) or file.read(len(_MAGIC)) != _MAGIC:
            raise ValueError("not an MCAP file")
        file.seek(-len(_MAGIC), os.SEEK_END)
        if file.read() != _MAGIC:
            raise ValueError("not a whole MCAP file: its end is missing")
        _bound(file, size)
        topics: dict[int, str] = {}
        for operation, body in _records(file, len(_MAGIC), size):
            if operation == _CHUNK_OP:
                unfolded = _unfolded(body)
                for inner, content in _records(BytesIO(unfolded), 0, len(unfolded)):
                    yield from _message(inner, content, topics)
            yield from _message(operation, body, topics)


def _bound(file: IO[bytes], size: int) -> None:
    """Refuse a file whose chunks claim to unfold to more than one of its size may."""
    most = _LARGEST + _UNFOLDS * size
    if sum(_claimed(body) for operation, body in _records(file, len(_MAGIC), size) if operation == _CHUNK_OP) > most:
        raise ValueError(f"a file of {size:,} bytes that claims to unfold to more than {most / MIB:,.0f} MiB")


def _records(file: IO[bytes], begin: int, size: int) -> Iterator[tuple[int, bytes]]:
    """Yield operation and content of each record from `begin` to that which ends the data, or to `size`."""
    file.seek(begin)
    operation = -1
    while begin < size and operation != _END_OP:
        operation, length = _HEAD.unpack(file.read(_HEAD.size))
        begin += _HEAD.size + length
        if length > _LARGEST or begin > size:
            raise ValueError(f"a record that claims {length:,} bytes in a file of {size:,}")
        yield operation, file.read(length)


def _claimed(chunk: bytes) -> int:
    """Return how many bytes a chunk claims to unfold to."""
    claimed: int = _CHUNK.unpack_from(chunk)[2]
    if claimed > _LARGEST:
        raise ValueError(f"a chunk that claims to unfold to {claimed:,} bytes; {_LARGEST:,} are the most")
    return claimed


def _unfolded(chunk: bytes) -> bytes:
    """Return the records of a chunk."""
    import pyarrow  # unfolds into as much memory as it is given, and no more

    claimed, (checksum, name_length) = _claimed(chunk), _CHUNK.unpack_from(chunk)[3:]
    name = chunk[_CHUNK.size :][:name_length].decode()
    content = chunk[_CHUNK.size + name_length + 8 :]
    unfolded: bytes = pyarrow.decompress(content, claimed, name, asbytes=True) if name else content
    if len(unfolded) != claimed or (checksum and crc32(unfolded) != checksum):
        raise ValueError("a chunk that is not what it claims to be")
    return unfolded


def _message(operation: int, body: bytes, topics: dict[int, str]) -> Iterator[Message]:
    """Yield the message of a record if it is one; note the topic of a channel."""
    if operation == _CHANNEL_OP:
        channel, _, length = struct.unpack_from("<HHI", body)
        topics[channel] = body[8:][:length].decode()
    elif operation == _MESSAGE_OP:
        channel, _, time_ns, _ = _MESSAGE.unpack_from(body)
        yield Message(topics[channel], time_ns, body[_MESSAGE.size :])
