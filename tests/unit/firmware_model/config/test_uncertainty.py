from pathlib import Path

import pytest

from firmware_model.config.spreads import Spread
from firmware_model.config.uncertainty import load_vehicle_set
from firmware_model.config.vehicle import VEHICLES, list_vehicles, load_vehicle
from firmware_model.errors import ConfigError
from gustproof.robust.uncertain.uncertainty import RealBlock


def written(folder: Path, old: str, new: str) -> Path:
    """Return the paper's vehicle file with one line changed."""
    text = (VEHICLES / "paper.toml").read_text(encoding="utf-8")
    assert old in text
    path = folder / "mine.toml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    return path


@pytest.mark.parametrize("name", list_vehicles())
def test_a_shipped_set_has_its_vehicle_in_the_middle(name):
    vehicles = load_vehicle_set(name)
    assert vehicles.nominal == load_vehicle(name)
    assert set(vehicles.spreads) == {
        "inertia_B.x", "inertia_B.y", "inertia_B.z", "actuator_lag",
        "gyro.snr_db", "gyro.bias_B.x", "gyro.bias_B.y", "gyro.bias_B.z",
    }  # fmt: skip


def test_delta_moves_the_number_that_it_names_and_no_other():
    vehicle = load_vehicle_set("paper").vehicle_at({"inertia_B.y": -1.0, "actuator_lag": 1.0, "gyro.bias_B.z": 0.5})
    assert vehicle.inertia_B == (0.25, 0.16, 0.1)
    assert vehicle.actuator_lag == 0.065
    assert vehicle.gyro.bias_B == (0.0, 0.0, 1e-5)
    assert vehicle.gyro.snr_db == 35.0


def test_delta_is_that_of_the_uncertain_model():
    spread = Spread(nominal=1.0, low=0.5, high=3.0)
    block = RealBlock(name="a", nominal=1.0, low=0.5, high=3.0)
    assert (spread.value(-1.0), spread.value(0.0), spread.value(1.0)) == (0.5, 1.0, 3.0)
    assert spread.value(0.3) == pytest.approx(float(block.value(0.3)), rel=1e-15)


def test_an_unknown_name_is_told_with_those_there_are():
    with pytest.raises(ValueError, match=r"unknown spread 'mas', there are inertia_B\.x, .*gyro\.snr_db"):
        load_vehicle_set("paper").vehicle_at({"mas": 0.1})


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("low = 0.035", "low = 0.055", r"actuator_lag: needs low < nominal < high, got 0\.055, 0\.05, 0\.065"),
        ("low = 0.035", "least = 0.035", r"mine\.toml: actuator_lag: .*least: unknown key"),
        ("low = 0.16", "low = 'small'", r"mine\.toml: inertia_B\.1: low: "),
        ("low = 0.035", "low = -0.035", r"vehicle 'mine': actuator_lag: .*greater than 0"),
        (
            "0.25, low = 0.2, high = 0.3",
            "0.31, low = 0.2, high = 0.4",
            r"mine\.toml: inertia_B: no rigid body has 0\.31",
        ),
        ("high = 0.3 }", "high = 0.4 }", r"mine\.toml: inertia_B: no rigid body has 0\.4 about x"),
        ("low = 0.035", "low = -1e308", r"actuator_lag: low or high is 0\.015 from nominal, the other 1e\+308"),
        ("high = 0.065", "high = 65", r"mine\.toml: actuator_lag: 65 is beyond .* s, of any multirotor: see its unit"),
        ("low = 0.16", "low = 0.01", r"mine\.toml: inertia_B: no rigid body has 0\.01 about y"),
    ],
)
def test_a_wrong_spread_is_one_clear_line(tmp_path, old, new, complaint):
    with pytest.raises(ConfigError, match=complaint) as told:
        load_vehicle_set(written(tmp_path, old, new))
    assert "\n" not in str(told.value)


def test_a_file_without_spreads_is_a_set_of_one(tmp_path):
    path = written(tmp_path, "{ nominal = 0.05, low = 0.035, high = 0.065 }", "0.05")
    vehicles = load_vehicle_set(path)
    assert "actuator_lag" not in vehicles.spreads
    assert vehicles.vehicle_at({"inertia_B.x": 1.0}).actuator_lag == 0.05


def test_lag_and_delay_are_known_as_a_sum(tmp_path: Path):
    """A delay of 10 ms, 4 to 16 at the lag of 50, leaves a lag of 44 to 56 beside it, narrower than the lag alone."""
    command = '\n[command]\nautopilot = "px4"\nfull_scale = "measured"\ndelay = '
    line = "rate_damping = 0.02"
    assert load_vehicle_set("paper").lag_range == pytest.approx((0.035, 0.065))
    path = written(tmp_path, line, "rate_damping = [0.02, { nominal = 0.3, low = 0.2, high = 0.4 }, 0.1]")
    path.write_text(path.read_text() + command + "{ nominal = 0.01, low = 0.004, high = 0.016 }\n")
    vehicles = load_vehicle_set(path)
    assert vehicles.lag_range == pytest.approx((0.044, 0.056))
    assert vehicles.nominal.rate_damping_B == (0.02, 0.3, 0.1)
    assert vehicles.vehicle_at({"rate_damping.y": 1.0}).rate_damping_B == pytest.approx((0.02, 0.4, 0.1))
    path.write_text(path.read_text().replace("low = 0.004, high = 0.016", "low = 0.0001, high = 0.06"))
    assert load_vehicle_set(path).lag_range == pytest.approx((0.0401, 0.1))
