"""The journal survives what happens to files."""

from pathlib import Path

import numpy as np
import pytest

from firmware_model.errors import ConfigError
from firmware_model.recording import journal
from firmware_model.recording.journal import (
    RECORD,
    WIDTH,
    JournalWriter,
    count_records,
    read_journal,
    record_blocks,
    record_type,
)


def write(path: Path, count: int) -> np.ndarray:
    records = np.random.default_rng(1).normal(size=(count, WIDTH))
    with JournalWriter(path, {"seed": 7}) as journal:
        for record in records:
            journal.append(record)
    return records


@pytest.mark.parametrize("count", [0, 1, 250, 613])
def test_what_is_appended_is_read_back_to_the_bit(tmp_path: Path, count: int) -> None:
    records = write(tmp_path / "j", count)
    header, back = read_journal(tmp_path / "j")
    assert header == {"seed": 7}
    assert back.dtype == RECORD
    assert back.tobytes() == records.tobytes()


def test_other_than_four_rotors_are_told_in_the_header_and_read_back(tmp_path: Path) -> None:
    record = record_type(8)
    rows = np.random.default_rng(1).normal(size=(5, record.itemsize // 8))
    with JournalWriter(tmp_path / "j", {"seed": 7}, 250, record) as journal:
        for row in rows:
            journal.append(row)
    header, back = read_journal(tmp_path / "j")
    assert header == {"rotors": 8, "seed": 7}
    assert (back["rotors"].shape, back.tobytes()) == ((5, 8), rows.tobytes())
    assert [record.fields[name][1] for name in RECORD.names if name != "rotors"] == [
        RECORD.fields[name][1] for name in RECORD.names if name != "rotors"
    ]
    assert count_records(tmp_path / "j", 8) == 5


def test_a_journal_cut_off_in_a_record_is_whole_up_to_the_one_before(tmp_path: Path) -> None:
    records = write(tmp_path / "j", 10)
    content = (tmp_path / "j").read_bytes()
    (tmp_path / "j").write_bytes(content[:-13])
    assert read_journal(tmp_path / "j")[1].tobytes() == records[:9].tobytes()


def test_a_crash_of_the_flight_leaves_its_records_behind(tmp_path: Path) -> None:
    def crash() -> None:
        with JournalWriter(tmp_path / "j", {}) as journal:
            journal.append(np.zeros(WIDTH))
            raise RuntimeError

    with pytest.raises(RuntimeError):
        crash()
    assert len(read_journal(tmp_path / "j")[1]) == 1


def test_a_journal_is_never_overwritten(tmp_path: Path) -> None:
    write(tmp_path / "j", 1)
    with pytest.raises(FileExistsError):
        write(tmp_path / "j", 1)


@pytest.mark.parametrize("content", [b"", b"not json\n", b"\xff\xfe\n", b'{"rotors": 17}\n', b'{"rotors": "4"}\n'])
def test_another_file_is_refused_by_name(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "j").write_bytes(content)
    with pytest.raises(ConfigError, match="not a journal"):
        read_journal(tmp_path / "j")


def test_a_growing_journal_counts_its_records_and_not_its_header(tmp_path: Path) -> None:
    path = tmp_path / "j"
    assert count_records(path) == 0
    path.write_bytes(b'{"half": "a hea')
    assert count_records(path) == 0
    path.unlink()
    with JournalWriter(path, {"note": "x" * 100_000}, buffer_records=10) as journal:
        assert count_records(path) == 0
        for _ in range(25):
            journal.append(np.zeros(WIDTH))
        assert count_records(path) == 20
    assert count_records(path) == 25


@pytest.mark.parametrize("rate_hz", [10, 1000])
def test_a_crash_loses_less_than_a_second_at_any_rate(tmp_path: Path, rate_hz: int) -> None:
    with JournalWriter(tmp_path / "j", {}, buffer_records=rate_hz) as journal:
        for _ in range(3 * rate_hz - 1):
            journal.append(np.zeros(WIDTH))
        assert 3 * rate_hz - 1 - count_records(tmp_path / "j") < rate_hz


@pytest.fixture
def long_from_8(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal, "_LONG", 7)


@pytest.mark.parametrize("count", [7, 8, 613])
def test_a_long_journal_is_read_to_the_bit_though_its_file_is_removed(
    tmp_path: Path, long_from_8: None, count: int
) -> None:
    records = write(tmp_path / "j", count)
    with (tmp_path / "j").open("ab") as file:
        file.write(b"half a record")
    _, back = read_journal(tmp_path / "j")
    (tmp_path / "j").unlink()
    assert back.tobytes() == records.tobytes()
    assert back.flags.writeable == (count < 8)


@pytest.mark.parametrize("count", [5, 8, 30, 33])
@pytest.mark.parametrize("cut", [None, 0, 1, 9, 10, 11, 29])
def test_sound_records_end_where_time_no_longer_increases(
    tmp_path: Path, long_from_8: None, monkeypatch: pytest.MonkeyPatch, count: int, cut: int | None
) -> None:
    records = np.zeros(count, RECORD)
    records["time_us"] = np.arange(count)
    if cut is not None:
        records["time_us"][cut:] = 0.0 if cut else np.nan
    (tmp_path / "j").write_bytes(b"{}\n" + records.tobytes())
    monkeypatch.setattr(record_blocks, "__defaults__", (10,))
    sound = count if cut is None else min(count, cut)
    assert read_journal(tmp_path / "j", sound=True)[1].tobytes() == records[:sound].tobytes()
    assert len(read_journal(tmp_path / "j")[1]) == count


@pytest.mark.parametrize("size", [1, 7, 10, 40])
def test_blocks_are_the_records_in_order(tmp_path: Path, long_from_8: None, size: int) -> None:
    records = write(tmp_path / "j", 30)
    _, mapped = read_journal(tmp_path / "j")
    for each in (mapped, mapped[4:21], np.array(mapped), mapped[:0]):
        blocks = list(record_blocks(each, size))
        assert [len(block) for block in blocks[:-1]] == [size] * (len(blocks) - 1)
        assert b"".join(block.tobytes() for block in blocks) == each.tobytes()
    assert mapped.tobytes() == records.tobytes()


def test_blocks_of_a_long_journal_leave_memory_as_they_are_used_up(tmp_path: Path) -> None:
    count = 1 << 17
    with (tmp_path / "j").open("wb") as file:
        file.write(b"{}\n")
        for _ in range(8):
            file.write(np.ones(count // 8 * WIDTH).tobytes())
    _, records = read_journal(tmp_path / "j")
    before, largest = resident_mib(), 0.0
    for _ in record_blocks(records):
        largest = max(largest, resident_mib() - before)
    assert largest < 30.0  # of 60


def resident_mib() -> float:
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return float(status.split("VmRSS:")[1].split()[0]) / 1024.0
