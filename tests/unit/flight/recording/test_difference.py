"""A bag is compared with records as if both were read whole."""

import numpy as np
import pytest

from firmware_model.errors import ConfigError
from firmware_model.recording.journal import RECORD, record_blocks
from gustproof.flight.recording import bag as bags
from gustproof.flight.recording import difference
from gustproof.flight.recording.bag import read_bag, read_flight, write_bag
from gustproof.flight.recording.difference import first_difference
from gustproof.flight.recording.topics import TOPICS
from gustproof.flight.routes.flight import first_difference_s

N, MODES = 50, (6 << 16, 4 << 16)


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    monkeypatch.setattr(difference, "_ROWS", 7)
    monkeypatch.setattr(record_blocks, "__defaults__", (9,))


def flight(rates=True):
    records = np.random.default_rng(2).standard_normal(N * RECORD.itemsize // 8).view(RECORD)
    records["time_us"] = np.arange(N) * 4000.0
    records["mode"] = np.where(np.arange(N) < 20, *MODES)
    if not rates:
        records["omega_command_B"] = np.nan
    return records


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp("bags") / "flight"
    write_bag(path, flight(), {"law": "hinf-d1"})
    return path


@pytest.fixture(scope="module")
def bag_without_rates(tmp_path_factory):
    path = tmp_path_factory.mktemp("bags") / "flight"
    write_bag(path, flight(rates=False), {})
    return path


def test_equal_records_do_not_differ_nor_do_those_of_a_flight_that_was_cut_off(bag, bag_without_rates):
    assert first_difference(bag, flight()) == (None, N)
    assert first_difference(bag_without_rates, flight(rates=False)) == (None, N)
    for count in (0, 1, 7, 33):
        assert first_difference(bag, flight()[:count]) == (None, N)
    assert first_difference(bag, np.concatenate([flight(), flight()])) == (None, N)


@pytest.mark.slow
@pytest.mark.parametrize("field", RECORD.names)
@pytest.mark.parametrize("row", [0, 6, 7, 33, N - 1])
def test_the_first_sample_that_differs_is_that_of_records_read_whole(bag, field, row):
    records = flight()
    changed = records[field][row:]
    changed[...] = np.where(changed == MODES[0], *MODES[::-1]) if field == "mode" else changed + 4000.0
    assert first_difference(bag, records) == (row, N)
    assert first_difference_s(records, read_bag(bag)[1]) == records["time_us"][row] * 1e-6
    assert first_difference(bag, records[:row]) == (None, N)


def test_a_sign_of_zero_and_an_unknown_number_are_differences(bag):
    for value in (np.nan, -0.0):
        records = flight()
        records["wind_N"][12, 1] = value
        assert first_difference(bag, records) == (12, N)


def test_rates_of_one_side_alone_are_a_difference(bag, bag_without_rates):
    assert first_difference(bag, flight(rates=False)) == (0, N)
    records = flight(rates=False)
    records["omega_command_B"][41, 2] = 0.0
    assert first_difference(bag_without_rates, records) == (41, N)


def test_a_bag_that_lacks_messages_is_not_taken_for_whole(tmp_path, monkeypatch):
    fewer = TOPICS[-1].name

    def cut(topic, rows):
        return encode(topic, rows[:0] if topic.name == fewer and rows["time_us"][0] > 0 else rows)

    encode, interleaved = bags.encode, bags.BagWriter.write_interleaved
    monkeypatch.setattr(bags, "encode", cut)
    monkeypatch.setattr(
        bags.BagWriter,
        "write_interleaved",
        lambda self, stamps, streams: [interleaved(self, stamps[: len(rows)], [(to, rows)]) for to, rows in streams],
    )
    write_bag(tmp_path / "flight", flight(), {})
    monkeypatch.setattr(bags, "encode", encode)
    with pytest.raises(ConfigError, match=f"flight: {fewer} has not as many messages as /imu"):
        first_difference(tmp_path / "flight", flight())


def test_the_metadata_are_those_of_the_whole_reader_and_a_bag_of_others_is_refused(bag, tmp_path):
    assert read_flight(bag) == read_bag(bag)[0] == {"law": "hinf-d1"}
    for reads in (read_flight, lambda path: first_difference(path, flight())):
        with pytest.raises(ConfigError, match="no topic /actuator/rotors: not a bag of a gustproof flight"):
            reads(tmp_path / "nothing")
