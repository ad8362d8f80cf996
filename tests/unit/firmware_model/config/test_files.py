"""Vehicle and scenario files: what is shipped is sound, and a mistake is one clear line."""

import json
from pathlib import Path

import numpy as np
import pytest

from firmware_model.config.files import checked_name, parse_json, shipped_path, tell_kind
from firmware_model.config.scenario import list_scenarios, load_scenario
from firmware_model.config.validation import printable
from firmware_model.config.vehicle import list_vehicles, load_vehicle
from firmware_model.errors import ConfigError

GOOD = 'description = "a test"\nduration_s = 1.0\n'


def test_the_paper_vehicle_has_the_numbers_of_table_1() -> None:
    vehicle = load_vehicle("paper")
    assert (vehicle.mass, vehicle.inertia_B) == (10.0, (0.25, 0.2, 0.1))


@pytest.mark.parametrize("name", list_vehicles())
def test_every_shipped_vehicle_loads_and_names_its_source(name: str) -> None:
    assert len(load_vehicle(name).source) > 20


@pytest.mark.parametrize("name", list_scenarios())
def test_every_shipped_scenario_loads_and_says_what_it_shows(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.name == name
    assert len(scenario.description) > 20


def test_the_scenarios_of_the_paper_are_shipped() -> None:
    assert {"paper", "paper-turbulence", "coning", "bias", "calm"} <= set(list_scenarios())


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (GOOD + "durations_s = 3\n", "durations_s: unknown key"),
        ("duration_s = 1.0\n", "description: missing"),
        (GOOD.replace("1.0", "-1.0"), "duration_s: input should be greater than 0 (given -1.0)"),
        (GOOD.replace("1.0", "nan"), "line 2, duration_s: must be a finite number (given nan)"),
        (GOOD + "control_rate_hz = 300\n", "physics_rate_hz must be a multiple of control_rate_hz"),
        (GOOD + "control_rate_hz = 2001\nphysics_rate_hz = 2001\n", "less than or equal to 2000"),
        (GOOD + '[[wind]]\nkind = "drydn"\n', "wind.0.kind: must be one of 'constant', 'step'"),
        (GOOD + '[[wind]]\nkind = "drydn"\n', "(given 'drydn'); did you mean 'dryden'?"),
        (GOOD + "[[wind]]\nspeed_mps = 3\n", "wind.0.kind: missing"),
        (GOOD + '[[wind]]\nkind = "constant"\nspeed = 3\n', "known are kind, velocity_mps, speed_mps, from_deg"),
        (GOOD + "[gyro]\nbias = 3\n", "gyro.bias: unknown key, known are bias_rad_s, noise"),
        (GOOD + '"a\\nb" = 3\n', "a\\nb: unknown key"),
        (GOOD + "[[event]]\nkind = 'payload'\n" * 90, "; and 70 more"),
        (
            GOOD + "[[event]]\nkind = 'payload'\nat_s = 0.5\n",
            "event.0.payload: mass_kg or mass_share: nothing is gained",
        ),
        (
            GOOD + "[[event]]\nkind = 'rotor_failure'\nat_s = 0.5\nrotor = 1\n",
            "'rotor_failure' needs translation = 'free'",
        ),
        (
            GOOD + "[[event]]\nkind = 'rotor_failure'\nat_s = 0.5\nrotor = 0\n",
            "rotor: input should be greater than or equal",
        ),
        (GOOD + '[[wind]]\nkind = "dryden"\nwind_speed_20ft_mps = 9\nW = 3\n', "W: unknown key"),
        (GOOD + '[[wind]]\nkind = "dryden"\nwind_speed_20ft_mps = 9\n' * 2, "at most one 'dryden'"),
        (
            GOOD + 'altitude_m = 304.9\n[[wind]]\nkind = "dryden"\nwind_speed_20ft_mps = 9\n',
            "altitude_m: 'dryden' is the low-altitude model, valid to 304.8 m (1000 ft), not at 304.9 m",
        ),
        ("duration_s = \n", "not TOML"),
        (
            GOOD + "translation = 'position_hold'\n[[event]]\nkind = 'attitude'\nat_s = 0.5\neuler_deg = [1, 0, 9]\n",
            "event: the roll and pitch of an 'attitude' are those of the position loop: give 0",
        ),
        (
            GOOD
            + "translation = 'position_hold'\n[[link]]\nkind = 'delay'\ndirection = 'to_vehicle'\ndelay_s = 0.01\n",
            "'position_hold' has no link, controller or mode events",
        ),
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


def test_an_unknown_name_has_the_nearest_known_one_and_a_missing_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"no scenario named 'papers'; did you mean 'paper'\?"):
        load_scenario("papers")
    with pytest.raises(ConfigError, match="No such file"):
        load_vehicle(tmp_path / "none.toml")


NO_LAW = "is no law, which is a .json file or a name; it is "


def find_law(path: Path) -> Path:
    return shipped_path("law", path, path.parent, ".json")


@pytest.mark.parametrize(
    ("load", "content", "told"),
    [
        (load_scenario, "inertia_B = [1, 1, 1]\nmass = 1.0", "is a vehicle file: give it as --vehicle"),
        (find_law, "inertia_B = [1, 1, 1]\nmass = 1.0", f"{NO_LAW}a vehicle file: give it as --vehicle"),
        (find_law, "duration_s = 1.0", f"{NO_LAW}a scenario file: give it as the scenario, --scenario or --air"),
        (load_scenario, "W_e = 1", "is a design file: it is for gustproof design"),
        (load_vehicle, "duration_s = 1.0", "is a scenario file: give it as the scenario, --scenario or --air"),
        (load_vehicle, "W_e = 1", "is a design file: it is for gustproof design"),
    ],
)
def test_a_file_of_another_kind_is_named_in_one_line(load, content, told, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(f"{content}\n")
    with pytest.raises(ConfigError) as caught:
        load(path)
    assert str(caught.value) == f"{path}: {told}"


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("a", b"ULog\x01\x12\x35", "a flight log: gustproof report shows it, identify makes a vehicle of it"),
        ("a.bin", b"\xa3\x95\x80\x80", "a flight log: "),
        ("a.mcap", b"\x89MCAP0\r\n", "a recorded flight: give its folder to gustproof report or replay"),
        ("run/f/f.mcap", b"", "a recorded flight: "),
        ("tables/facts.json", b"", "a law as tables: give it as --law"),
        ("a.txt", b"PAR1....PAR1", "a campaign's table: "),
        ("K.x", b"MATLAB 5.0 MAT-file", "a law: give it as --law"),
        ("a.json", b'{"format": "gustproof-law-1"}', "a law: give it as --law"),
        ("a.txt", b'{"format": "gustproof-certificate-1"}', "a certificate: gustproof certify check reads it"),
        ("a.toml", b"duration_s = 1.0\n", "a scenario file: "),
        ("a.params", b"MC_ROLL_P 6.5\n", "a parameter file: give it as --law or --params, or to judge"),
        ("a.html", b"<!DOCTYPE html>", "a page for a browser"),
        ("empty/here/b", b"", "a folder"),
    ],
)
def test_a_kind_is_told_by_what_is_in_a_file(name, content, told, tmp_path: Path) -> None:
    (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / name).write_bytes(content)
    assert tell_kind(tmp_path / Path(name).parts[0]).startswith(f"; it is {told}")


@pytest.mark.parametrize(
    ("name", "content"),
    [("a.txt", b"hello"), ("a.json", b"{"), ("a.json", b"[]"), ("a.toml", b"x"), ("a.toml", b"x = 1"), ("a", b"")],
)
def test_what_is_of_no_kind_is_told_nothing(name, content, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    assert tell_kind(tmp_path / name) == tell_kind(tmp_path / "nowhere") == ""


def test_a_file_of_another_format_is_not_looked_up_as_a_name(tmp_path: Path) -> None:
    for name, told in (("my-law.json", "a law is given as --law"), ("a.ulg", "gustproof identify makes a vehicle")):
        (tmp_path / name).touch()
        with pytest.raises(ConfigError, match=rf"{name}: is no vehicle, which is a \.toml file or a name; {told}"):
            load_vehicle(tmp_path / name)
    (tmp_path / "k.mat").touch()
    with pytest.raises(ConfigError, match=r"k\.mat: is no law, which is .* --law FILE\.json makes one of it$"):
        shipped_path("law", tmp_path / "k.mat", tmp_path, ".json")


def test_a_name_is_one_part_of_a_path_in_any_script() -> None:
    for name in ("hinf-d1", "Böe 3.5 m/s".replace("/", " per "), "突风", "v1.2_final (3)", "a" * 100):
        assert checked_name(name) == name
    for name in (
        "",
        " ",
        ".",
        "..",
        ".a",
        "a/b",
        "a\\b",
        "$x$",
        "a\n",
        "\x1b[2J",
        "\u202e",
        "\ud800",
        "a" * 101,
        "风" * 34,
        7,
    ):
        with pytest.raises(ValueError, match="a name "):
            checked_name(name)  # type: ignore[arg-type]


def test_a_text_loses_what_a_terminal_may_obey_and_nothing_else() -> None:
    assert printable("a\x1b[2J\nb\x9b\u202e風", keep="\n") == "a\\x1b[2J\nb\\x9b\\u202e風"


def test_numbers_of_a_json_text_are_those_of_the_standard_library_to_the_bit() -> None:
    numbers = np.random.default_rng(1).integers(0, 2**63, 10_000, np.uint64).view(np.float64).tolist()
    text = f"[-0.0, 5e-324, 2.2250738585072011e-308, 123456789012345678901234.5, {json.dumps(numbers)[1:]}"
    assert np.array(parse_json(text)).tobytes() == np.array(json.loads(text)).tobytes()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\xef\xbb\xbf" + GOOD.encode(), "not TOML: it begins with a byte order mark: save it as UTF-8 without one"),
        (GOOD.encode() + b"# B\xf6e\n", "not TOML: byte 0xf6 in line 3 is not UTF-8: save it as UTF-8"),
        (GOOD.encode() + b"[wind]\nkind = 'dryden'\n", "line 3, wind: there may be many: write [[wind]]"),
    ],
)
def test_a_file_of_another_editor_is_told_what_to_do(content: bytes, message: str, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_bytes(content)
    with pytest.raises(ConfigError) as caught:
        load_scenario(tmp_path / "mine.toml")
    assert str(caught.value) == f"{tmp_path / 'mine.toml'}: {message}"


@pytest.mark.parametrize("name", list_scenarios())
def test_all_that_a_shipped_scenario_says_is_flown(name: str) -> None:
    assert load_scenario(name).unflown == ()


def test_what_is_after_the_end_and_the_drift_of_a_held_vehicle_are_told(tmp_path: Path) -> None:
    late = "[[event]]\nkind = 'mode'\nmode = 'hold'\nat_s = {0}\n[[moment]]\nkind = 'step'\namplitude_nm = [1, 0, 0]\n"
    drift = "start_s = {0}\n[[require]]\nmetric = 'drift_m'\nat_most = 1.0\n"
    (tmp_path / "mine.toml").write_text(GOOD + (late + drift).format("1.0"))
    assert load_scenario(tmp_path / "mine.toml").unflown == (
        "event.0: at_s 1.0 is not before the end, 1.0 s: it is never flown",
        "moment.0: start_s 1.0 is not before the end, 1.0 s: it is never flown",
        "require.0: drift_m of a vehicle that is held is 0: give translation = 'free'",
    )
    (tmp_path / "mine.toml").write_text("translation = 'free'\n" + GOOD + (late + drift).format("0.99"))
    assert load_scenario(tmp_path / "mine.toml").unflown == ()
