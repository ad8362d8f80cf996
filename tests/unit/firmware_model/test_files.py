"""Vehicle and scenario files: what is shipped is sound, and a mistake is one clear line."""

from pathlib import Path

import pytest

from firmware_model.errors import ConfigError
from firmware_model.scenario import load_scenario, shipped_scenarios
from firmware_model.vehicle import load_vehicle, shipped_vehicles

GOOD = 'description = "a test"\nduration_s = 1.0\n'


def test_the_paper_vehicle_has_the_numbers_of_table_1() -> None:
    vehicle = load_vehicle("paper")
    assert (vehicle.mass, vehicle.inertia_B) == (10.0, (0.25, 0.2, 0.1))


@pytest.mark.parametrize("name", shipped_vehicles())
def test_every_shipped_vehicle_loads_and_names_its_source(name: str) -> None:
    assert len(load_vehicle(name).source) > 20


@pytest.mark.parametrize("name", shipped_scenarios())
def test_every_shipped_scenario_loads_and_says_what_it_shows(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.name == name
    assert len(scenario.description) > 20


def test_the_shipped_scenarios_are_those_of_the_readme() -> None:
    assert {"paper", "paper-turbulence", "coning", "bias", "calm"} <= set(shipped_scenarios())


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (GOOD + "durations_s = 3\n", "durations_s: unknown key"),
        ("duration_s = 1.0\n", "description: missing"),
        (GOOD.replace("1.0", "-1.0"), "duration_s: input should be greater than 0 (given -1.0)"),
        (GOOD.replace("1.0", "nan"), "duration_s: input should be"),
        (GOOD + "control_rate_hz = 300\n", "physics_rate_hz must be a multiple of control_rate_hz"),
        (GOOD + "control_rate_hz = 600\nphysics_rate_hz = 1200\n", "must divide 1,000,000"),
        (GOOD + '[[wind]]\nkind = "drydn"\n', "wind.0.kind: must be one of 'constant', 'step'"),
        (GOOD + '[[wind]]\nkind = "drydn"\n', "(given 'drydn')"),
        (GOOD + "[[wind]]\nspeed_mps = 3\n", "wind.0.kind: missing"),
        (GOOD + '[[wind]]\nkind = "constant"\nspeed = 3\n', "known are kind, velocity_mps, speed_mps, from_deg"),
        (GOOD + "[gyro]\nbias = 3\n", "gyro.bias: unknown key, known are bias_rad_s, noise"),
        (GOOD + '"a\\nb" = 3\n', "a\\nb: unknown key"),
        (GOOD + "[[event]]\nkind = 'payload'\n" * 30, "; and 70 more"),
        (GOOD + '[[wind]]\nkind = "dryden"\nwind_speed_20ft_mps = 9\nW = 3\n', "W: unknown key"),
        (GOOD + '[[wind]]\nkind = "dryden"\nwind_speed_20ft_mps = 9\n' * 2, "at most one 'dryden'"),
        ("duration_s = \n", "not TOML"),
    ],
)
def test_a_mistake_is_one_line_with_file_and_key(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(content)
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_every_mistake_is_reported_at_once(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('duration_s = "long"\nfoo = 1\n')
    with pytest.raises(ConfigError, match=r"duration_s.*foo|foo.*duration_s"):
        load_scenario(path)


def test_an_unknown_name_lists_the_known_ones_and_a_missing_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"no scenario named 'papers'.*paper-turbulence"):
        load_scenario("papers")
    with pytest.raises(ConfigError, match="No such file"):
        load_vehicle(tmp_path / "none.toml")
