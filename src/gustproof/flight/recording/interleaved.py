"""Write many messages of equal size to a bag at once, with the bytes that rosbags writes one by one.

A flight has a hundred thousand messages, and to make each in Python would take longer than to fly. The records of a
chunk are one table instead; chunks begin where they would, and have the same index. They also have a checksum.
"""

from binascii import crc32
from collections import defaultdict
from collections.abc import Sequence
from io import BytesIO
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import (
    McapWriter,
    PendingChunk,
    write_record,
    write_string,
    write_uint16,
    write_uint32,
    write_uint64,
)

from firmware_model.config.files import MIB

_MESSAGE_OP, _CHUNK_OP, _INDEX_OP = 0x05, 0x06, 0x07
_HEAD = [
    ("operation", "u1"),
    ("length", "<u8"),
    ("channel", "<u2"),
    ("sequence", "<u4"),
    ("log_time", "<u8"),
    ("publish_time", "<u8"),
]
_BEFORE_LENGTH = 9  # [bytes] of operation and length, which a record's length leaves out
Stream = tuple[Any, NDArray[np.void]]
"""Connection of a topic, and its serialised messages."""


class _Storage(McapWriter):  # type: ignore[misc]
    """MCAP file of rosbags, to whose chunk under way many messages are added at once.

    Their part of a channel's index is a table (k, 2) of times [ns] and offsets, where that of one message is a pair.
    """

    chunk: Any
    message_start_time: int
    message_end_time: int

    def write_interleaved(self, stamps_ns: NDArray[np.int64], streams: Sequence[Stream]) -> None:
        width, done = len(streams), 0
        records = _records(stamps_ns, streams)
        sizes = [records.dtype[i].itemsize for i in range(width)]
        starts = np.append(0, np.arange(len(records))[:, None] * records.dtype.itemsize + np.cumsum(sizes))
        content = records.view(np.uint8).data
        while done < len(starts) - 1:
            chunk, begin = self.chunk, int(starts[done])
            shift = chunk.bio.tell() - begin
            # up to the first record that ends beyond the limit; one at least, as a new topic may have filled the chunk
            last = min(max(int(np.searchsorted(starts, MIB - shift, side="right")), done + 1), len(starts) - 1)
            chunk.bio.write(content[begin : starts[last]])
            for first in range(done, min(done + width, last)):
                offsets = starts[first:last:width] + shift
                stamps = stamps_ns[first // width :][: len(offsets)]
                chunk.msgs[streams[first % width][0].id].append(np.column_stack([stamps, offsets]))
            written = stamps_ns[done // width : (last - 1) // width + 1]
            chunk.message_start_time = min(chunk.message_start_time, int(written.min()))
            chunk.message_end_time = max(chunk.message_end_time, int(written.max()))
            if chunk.bio.tell() > MIB:
                self.close_chunk()
            done = last
        self.message_start_time = min(self.message_start_time, int(stamps_ns.min()))
        self.message_end_time = max(self.message_end_time, int(stamps_ns.max()))
        for connection, _ in streams:
            self.channel_stats[connection.id] += len(stamps_ns)

    def close_chunk(self) -> None:
        """Write the chunk under way and its index, as rosbags does, and the checksum that it leaves out."""
        chunk, file = self.chunk, self.bio
        content = chunk.bio.getvalue()
        size, compressed = len(content), self.compressor(content)
        record = BytesIO()
        for number in (chunk.message_start_time, chunk.message_end_time, size):
            write_uint64(record, number)
        write_uint32(record, crc32(content))
        write_string(record, self.compression)
        write_uint64(record, len(compressed))
        record.write(compressed)
        start = file.tell()
        write_record(file, _CHUNK_OP, record)
        end, offsets = file.tell(), BytesIO()
        for channel, parts in chunk.msgs.items():
            write_uint16(offsets, channel)
            write_uint64(offsets, file.tell())
            index = b"".join(np.asarray(part, dtype="<u8").tobytes() for part in parts)
            record = BytesIO()
            write_uint16(record, channel)
            write_uint32(record, len(index))
            record.write(index)
            write_record(file, _INDEX_OP, record)
        record = BytesIO()
        for number in (chunk.message_start_time, chunk.message_end_time, start, end - start):
            write_uint64(record, number)
        write_uint32(record, offsets.tell())
        record.write(offsets.getbuffer())
        write_uint64(record, file.tell() - end)
        write_string(record, self.compression)
        write_uint64(record, len(compressed))
        write_uint64(record, size)
        self.chunks.append(record)
        self.chunk = PendingChunk(2**63 - 1, 0, BytesIO(), defaultdict(list))


class BagWriter(Writer):  # type: ignore[misc]
    """Writer of rosbags for MCAP that takes many messages at once too."""

    min_timestamp: int
    max_timestamp: int
    STORAGE_PLUGINS: ClassVar = {StoragePlugin.MCAP: _Storage}

    def write_interleaved(self, stamps_ns: NDArray[np.int64], streams: Sequence[Stream]) -> None:
        """Write messages (n,) of each of `streams` under `stamps_ns` (n,), those of one row in the streams' order."""
        if not (streams and len(stamps_ns)):
            return
        self.storage.write_interleaved(stamps_ns, streams)
        self.min_timestamp = min(self.min_timestamp, int(stamps_ns.min()))
        self.max_timestamp = max(self.max_timestamp, int(stamps_ns.max()))
        for connection, _ in streams:
            self.counts[connection.id] += len(stamps_ns)


def _records(stamps_ns: NDArray[np.int64], streams: Sequence[Stream]) -> NDArray[np.void]:
    """Return the records (n,) of messages as MCAP has them, one field for each stream."""
    records = np.zeros(
        len(stamps_ns), dtype=[(str(i), [*_HEAD, ("content", rows.dtype)]) for i, (_, rows) in enumerate(streams)]
    )
    for i, (connection, rows) in enumerate(streams):
        record = records[str(i)]
        record["operation"], record["length"] = _MESSAGE_OP, record.dtype.itemsize - _BEFORE_LENGTH
        record["channel"], record["content"] = connection.id, rows
        record["log_time"] = record["publish_time"] = stamps_ns
    return records
