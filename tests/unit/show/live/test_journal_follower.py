from threading import Event, Thread

import numpy as np
import pytest

from firmware_model.numerics.rotations import rotate
from firmware_model.recording.journal import RECORD, JournalWriter, record_type
from gustproof.show.live.journal_follower import follow_journal, rotate_rows, series_rows
from gustproof.show.live.telemetry_buffer import TelemetryBuffer


@pytest.fixture(params=[4, 8])
def records(request, rng) -> np.ndarray:
    records = np.zeros(523, dtype=record_type(request.param))
    for name in records.dtype.names:
        records[name] = rng.normal(size=records[name].shape)
    records["q_NB"] /= np.linalg.norm(records["q_NB"], axis=1, keepdims=True)
    records["time_us"] = 4000.0 * np.arange(len(records))
    return records


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def test_vectors_are_rotated_as_one_by_one(rng):
    q_NB, v_B = rng.normal(size=(20, 4)), rng.normal(size=(20, 3))
    q_NB /= np.linalg.norm(q_NB, axis=1, keepdims=True)
    expected = [rotate(tuple(q), tuple(v)) for q, v in zip(q_NB.tolist(), v_B.tolist(), strict=True)]
    np.testing.assert_allclose(rotate_rows(q_NB, v_B), expected, atol=1e-14)


def test_east_wind_of_a_vehicle_that_looks_east_comes_from_ahead():
    record = np.zeros(1, dtype=RECORD)
    record["q_NB"] = [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]  # heading 90 deg
    record["gust_B"] = [-3.0, 0.0, 0.0]
    record["wind_N"] = [1.0, 0.0, 0.0]
    assert series_rows(record[:, np.newaxis], 4000)["wind"] == [[0.0, 1.0, -3.0, 0.0]]


def test_age_is_the_oldest_of_its_group_and_none_where_no_command_acts():
    groups = np.zeros((3, 5), dtype=RECORD)
    groups["time_us"] = 4000.0 * np.arange(-4, 11).reshape(3, 5)
    groups["command_age"] = 1.0
    groups["command_age"][1, 2] = 7.0
    groups["command_age"][2, 3] = np.nan
    assert series_rows(groups, 4000)["age"] == [[0.0, 4.0], [0.02, 28.0], [0.04, None]]


def test_each_fifth_record_is_fed_however_the_journal_grows(records, tmp_path, monkeypatch):
    monkeypatch.setattr("gustproof.show.live.journal_follower._POLL_S", 0.001)
    path, feed, done = tmp_path / "journal", TelemetryBuffer(), Event()
    reader = feed.reader()
    thread = Thread(target=follow_journal, args=(path, 5, 4000, feed, done))
    thread.start()
    with JournalWriter(path, {"scenario": "any"}, 250, records.dtype) as journal:
        for record in records:
            journal.append(record.view((np.float64, records.dtype.itemsize // 8)))
            if record["time_us"] % 68_000 == 0:
                journal.flush()
    done.set()
    thread.join(60.0)
    assert not thread.is_alive()
    news = reader.read()
    for name, rows in series_rows(records[::5, np.newaxis], 4000).items():
        assert name == "age" or news[name] == rows
    age = records["command_age"][:, 0]
    oldest = [age[0], *(age[last - 4 : last + 1].max() for last in range(5, len(age), 5))]
    np.testing.assert_allclose(np.array(news["age"])[:, 1], 4.0 * np.array(oldest), atol=5.1e-7)
    np.testing.assert_allclose(np.array(news["attitude"])[:, 1:5], records["q_NB"][::5], atol=5.1e-7)
    np.testing.assert_allclose(np.array(news["torque"])[:, 1:], records["torque_command_B"][::5], atol=5.1e-7)


def test_tail_ends_when_no_journal_ever_comes(tmp_path):
    done = Event()
    done.set()
    follow_journal(tmp_path / "none", 5, 4000, TelemetryBuffer(), done)
