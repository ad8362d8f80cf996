from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from firmware_model.recording.estimates import ESTIMATE
from gustproof.flight.recording.bag import write_bag
from gustproof.flight.routes.direct import fly_direct
from gustproof.law.form import load_law
from gustproof.logs.read.flight_log import CommandUnit
from gustproof.logs.read.read_log import read_log


@pytest.fixture(scope="module")
def records() -> np.ndarray:
    scenario = replace(load_scenario("paper-turbulence"), duration_s=1.0)
    return fly_direct(scenario, load_law("hinf-d1"), vehicle=load_vehicle("paper"))


def test_read_log_of_a_bag_takes_what_was_measured_and_sent(tmp_path: Path, records: np.ndarray) -> None:
    bag = tmp_path / "run" / "flight"
    write_bag(bag, records, {})
    for path in (bag, bag.parent, next(bag.glob("*.mcap"))):
        log = read_log(path)
        assert (log.source, log.system, log.command_unit) == (path.name, "gustproof", CommandUnit.NEWTON_METRES)
        assert np.array_equal(log.gyro.values, records["gyro_B"])
        assert log.gyro.time == pytest.approx(1e-6 * (records["time_us"] - records["time_us"][0]))
        assert log.command is not None
        assert np.array_equal(log.command.values, records["torque_command_B"])
        assert log.attitude is None
        assert log.reference is None
        assert log.airborne == ((0.0, log.gyro.time[-1]),)
        assert log.findings == ("not in this log: motors, attitude, reference",)


def test_read_log_of_a_bag_takes_the_attitude_that_a_real_autopilot_told(tmp_path: Path, records: np.ndarray) -> None:
    estimates = np.zeros(100, dtype=ESTIMATE)
    estimates["time_us"] = records["time_us"][0] + 8000.0 * np.arange(100) + 1000.0
    estimates["q_NB"] = [np.cos(0.05), np.sin(0.05), 0.0, 0.0]
    estimates["setpoint_q_NB"] = np.nan
    estimates["setpoint_q_NB"][50:] = [1.0, 0.0, 0.0, 0.0]
    write_bag(tmp_path / "flight", records, {}, estimates)
    log = read_log(tmp_path / "flight")
    assert log.attitude is not None
    assert log.reference is not None
    assert log.attitude.values == pytest.approx(np.tile([0.1, 0.0, 0.0], (100, 1)))
    assert (len(log.reference.time), log.reference.time[0]) == (50, pytest.approx(0.401))


def test_read_log_of_a_folder_without_a_bag(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no bag in it"):
        read_log(tmp_path)


def test_read_log_of_a_cut_bag(tmp_path: Path, records: np.ndarray) -> None:
    write_bag(tmp_path / "flight", records, {})
    file = next((tmp_path / "flight").glob("*.mcap"))
    file.write_bytes(file.read_bytes()[:-100])
    for path in (file, tmp_path):
        with pytest.raises(ConfigError, match=r"flight(\.mcap)?: not a whole MCAP file: its end is missing"):
            read_log(path)
