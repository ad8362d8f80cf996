"""Write many messages of equal size to a bag at once, with the bytes that rosbags writes one by one.

A flight has a hundred thousand messages, and to make each in Python would take longer than to fly. The records of a
chunk are one table instead; chunks begin where they would, and have the same index.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import Writer

from firmware_model.config.files import MIB

_MESSAGE_OP = 0x05
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


def write_interleaved(writer: Writer, stamps_ns: NDArray[np.int64], streams: Sequence[Stream]) -> None:
    """Write the messages (n,) of each of `streams` under `stamps_ns` (n,), those of one row in the streams' order."""
    if not (streams and len(stamps_ns)):
        return
    width, storage, done = len(streams), writer.storage, 0
    records = _records(stamps_ns, streams)
    sizes = [records.dtype[i].itemsize for i in range(width)]
    starts = np.append(0, np.arange(len(records))[:, None] * records.dtype.itemsize + np.cumsum(sizes))
    content = memoryview(records.view(np.uint8))
    while done < len(starts) - 1:
        chunk, begin = storage.chunk, int(starts[done])
        shift = chunk.bio.tell() - begin
        # up to the first record that ends beyond the limit
        last = min(int(np.searchsorted(starts, MIB - shift, side="right")), len(starts) - 1)
        chunk.bio.write(content[begin : starts[last]])
        for first in range(done, min(done + width, last)):
            offsets = (starts[first:last:width] + shift).tolist()
            stamps = stamps_ns[first // width :][: len(offsets)].tolist()
            chunk.msgs[streams[first % width][0].id].extend(zip(stamps, offsets, strict=True))
        written = stamps_ns[done // width : (last - 1) // width + 1]
        chunk.message_start_time = min(chunk.message_start_time, int(written.min()))
        chunk.message_end_time = max(chunk.message_end_time, int(written.max()))
        if chunk.bio.tell() > MIB:
            storage.close_chunk()
        done = last
    earliest, latest = int(stamps_ns.min()), int(stamps_ns.max())
    writer.min_timestamp, writer.max_timestamp = min(writer.min_timestamp, earliest), max(writer.max_timestamp, latest)
    storage.message_start_time = min(storage.message_start_time, earliest)
    storage.message_end_time = max(storage.message_end_time, latest)
    for connection, _ in streams:
        writer.counts[connection.id] += len(stamps_ns)
        storage.channel_stats[connection.id] += len(stamps_ns)


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
