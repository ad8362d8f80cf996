"""Messages written many at once are the bytes that rosbags writes one by one, but for the checksums that it lacks."""

import struct

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from gustproof.flight.recording.interleaved import BagWriter
from gustproof.flight.recording.mcap import messages

SIZES, N = (4, 3000, 1500), 1000
ROWS = [np.random.default_rng(size).bytes(size * N) for size in SIZES]


def write(folder, kind, write_all):
    """Return the files of a bag of three topics between two single messages."""
    writer = kind(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        about, *topics = (
            writer.add_connection(f"/{name}", "a/msg/A", msgdef="uint8 x", rihs01="0") for name in ("about", *"abc")
        )
        writer.write(about, 7, b"before")
        write_all(writer, topics)
        writer.write(about, 9, b"after")
    return [(path.name, without_checksums(path.read_bytes())) for path in sorted((folder / "bag").iterdir())]


def chunks(mcap):
    """Return the places of all chunks' contents."""
    place, found = 8, []
    while mcap[place] != 0x0F:  # end of the data
        found += [place + 9] * (mcap[place] == 0x06)
        place += 9 + struct.unpack_from("<Q", mcap, place + 1)[0]
    return found


def without_checksums(content):
    mcap = bytearray(content)
    for place in chunks(mcap) if content.startswith(b"\x89MCAP") else ():
        mcap[place + 24 : place + 28] = bytes(4)
    return bytes(mcap)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """Return a bag of two messages, 40 kB, and its file."""
    folder = tmp_path_factory.mktemp("small")

    def rows(writer, topics):
        writer.write_interleaved(np.arange(10), [(topics[0], np.frombuffer(ROWS[0][:40], dtype="V4"))])

    write(folder, BagWriter, rows)
    return folder / "bag" / "bag.mcap"


def test_each_changed_byte_of_the_data_is_told(small, tmp_path):
    """Compression alone let a fifth of damaged flights pass, with other numbers."""
    sound, file = list(messages(small)), tmp_path / "damaged.mcap"
    content = small.read_bytes()
    begin, end = chunks(content)[0] - 9, content.index(b"zstd") + 400
    silent = 0
    for place in range(begin, end):
        file.write_bytes(content[:place] + bytes([content[place] ^ 0x10]) + content[place + 1 :])
        try:
            silent += list(messages(file)) != sound
        except Exception:  # all that the callers name the file in
            continue
    assert silent == 0


def test_a_lost_message_is_told_by_the_summary(small, tmp_path):
    content, file = small.read_bytes(), tmp_path / "lost.mcap"
    place = chunks(content)[0] - 9
    file.write_bytes(content[:place] + b"\x86" + content[place + 1 :])  # a record that readers pass over
    with pytest.raises(ValueError, match="it is damaged: 0 of 12 messages"):
        list(messages(file))


@pytest.mark.parametrize("stamps", [np.arange(N) * 4000, np.arange(N)[::-1] * 1000], ids=["forth", "back"])
def test_many_at_once_are_the_bytes_of_one_by_one(stamps, tmp_path):
    def many(writer, topics):
        rows = [np.frombuffer(payload, dtype=f"V{size}") for payload, size in zip(ROWS, SIZES, strict=True)]
        writer.write_interleaved(stamps, list(zip(topics, rows, strict=True)))

    def one_by_one(writer, topics):
        for i, stamp in enumerate(stamps.tolist()):
            for topic, payload, size in zip(topics, ROWS, SIZES, strict=True):
                writer.write(topic, stamp, payload[i * size : (i + 1) * size])

    (tmp_path / "many").mkdir()
    (tmp_path / "one").mkdir()
    files = write(tmp_path / "many", BagWriter, many)
    assert files == write(tmp_path / "one", Writer, one_by_one)
    assert [name for name, _ in files] == ["bag.mcap", "metadata.yaml"]
    assert len(files[0][1]) > 4 << 20  # more than four chunks


def test_nothing_is_written_of_no_rows_or_topics(tmp_path):
    def nothing(writer, topics):
        writer.write_interleaved(np.arange(0), [(topics[0], np.zeros(0, dtype="V4"))])
        writer.write_interleaved(np.arange(3), [])

    write(tmp_path, BagWriter, nothing)
    assert list(messages(tmp_path / "bag" / "bag.mcap")) == [("/about", 7, b"before"), ("/about", 9, b"after")]


def test_a_topic_that_fills_a_chunk_ends_it_after_one_message_more(tmp_path):
    """A chunk of just under 1 MiB was full by a topic's definition: a bag of the paper's scenario was not written."""

    def late(rows):
        def write_all(writer, topics):
            writer.write(topics[0], 8, bytes((1 << 20) - 2000))
            topic = writer.add_connection("/late", "b/msg/B", msgdef="uint8 x\n" * 400, rihs01="0")
            rows(writer, topic)

        return write_all

    def many(writer, topic):
        writer.write_interleaved(np.arange(10) * 1000, [(topic, np.frombuffer(bytes(400), dtype="V40"))])

    def one_by_one(writer, topic):
        for i in range(10):
            writer.write(topic, i * 1000, bytes(40))

    (tmp_path / "many").mkdir()
    (tmp_path / "one").mkdir()
    assert write(tmp_path / "many", BagWriter, late(many)) == write(tmp_path / "one", Writer, late(one_by_one))
