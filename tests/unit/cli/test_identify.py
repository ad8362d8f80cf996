"""`gustproof identify` from the log of a flight to files that fly."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from firmware_model.config.scenario import load_scenario
from firmware_model.config.uncertainty import load_vehicle_set
from firmware_model.config.vehicle import load_vehicle
from gustproof.cli.app import app
from gustproof.cli.identify.log import _tell_outputs
from gustproof.flight.recording.bag import write_bag
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.flight import FlightPlan
from gustproof.law.form import load_law
from gustproof.logs.identify import identify_vehicle as identification
from gustproof.logs.identify.identify_vehicle import identify
from gustproof.logs.read.flight_log import FlightLog

IRIS = load_vehicle("iris")
LAW = "pid-fair"


def run(*arguments):
    return CliRunner().invoke(app, ["identify", *map(str, arguments)])


def one_line(result):
    assert result.exit_code == 2
    assert "Traceback" not in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    return result.stderr.strip()


def record(folder, name):
    """Fly a shipped scenario with the Iris, write its bag, and return it with its records."""
    plan = FlightPlan(load_scenario(name), load_law(LAW), IRIS, 1, False)
    records = fly_direct(plan.scenario, plan.controller, vehicle=IRIS, seed=1)
    write_bag(folder / name / plan.name, records, {**plan.metadata(), "outcome": "done"})
    return folder / name, records


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """The manoeuvre for identification, as a bag."""
    return record(tmp_path_factory.mktemp("flights"), "doublets")


@pytest.fixture(scope="module")
def identified(flight, tmp_path_factory):
    """Everything that the command writes, and what it prints as JSON."""
    folder = tmp_path_factory.mktemp("identified")
    names = {"-o": "twin.toml", "--report": "twin.html", "--wind": "gust.csv", "--scenario": "gust.toml"}
    files = [text for option, name in names.items() for text in (option, folder / name)]
    result = run(flight[0], *files, "--like", "iris", "--json")
    assert result.exit_code == 0, result.output
    return folder, json.loads(result.stdout)


@pytest.mark.slow
def test_the_vehicle_is_the_one_that_flew(identified):
    folder, document = identified
    vehicles = load_vehicle_set(folder / "twin.toml")
    assert vehicles.nominal.inertia_B == pytest.approx(IRIS.inertia_B, rel=0.05)
    assert vehicles.nominal.actuator_lag == pytest.approx(IRIS.actuator_lag, rel=0.1)
    assert vehicles.nominal.gyro.noise_density == pytest.approx(IRIS.gyro.noise_density, rel=0.1)
    assert list(document["actuator_lag_s"]) == ["low", "nominal", "high"]
    assert all(document["held_out_r2"][axis] > 0.8 for axis in ("roll", "pitch", "yaw"))
    assert document["files"]["vehicle"] == str(folder / "twin.toml")


@pytest.mark.slow
def test_the_air_is_that_of_the_flight(identified):
    dryden = identified[1]["disturbance"]["dryden"]
    assert 20.0 * abs(np.log10(dryden["wind_speed_20ft_mps"] / 3.0)) < 2.0
    (wind,) = load_scenario(identified[0] / "gust.toml").wind
    assert wind.wind_speed_20ft == dryden["wind_speed_20ft_mps"]


def test_the_wind_flies_the_moments_again(identified, flight):
    folder, (_, records) = identified[0], flight
    day = 'description = "again"\nduration_s = 30.0\n[[wind]]\nkind = "replay"\nfile = "gust.csv"\n'
    (folder / "day.toml").write_text(day)
    twin = load_vehicle(folder / "twin.toml")
    again = fly_direct(load_scenario(folder / "day.toml"), load_law(LAW), vehicle=twin, seed=2)
    drag = np.array(IRIS.inertia_B) * IRIS.rate_damping_B
    truth = (records["moment_B"] + drag * records["gust_omega_B"])[: len(again)]
    ratio = again["moment_B"].std(axis=0) / truth.std(axis=0)
    assert np.all(np.abs(20.0 * np.log10(ratio)) < 2.0)


def test_the_report_opens_without_a_network(identified):
    page = (identified[0] / "twin.html").read_text(encoding="utf-8")
    assert "default-src 'none'" in page
    assert not any(f'{key}="http' in page for key in ("src", "href"))


@pytest.mark.slow
def test_the_terminal_shows_the_table_and_the_next_step(flight, tmp_path, monkeypatch):
    found = []  # identified once, shown twice
    monkeypatch.setattr(
        identification, "identify", lambda log, **_: found[0] if found else found.append(identify(log)) or found[0]
    )
    result = run(flight[0], "-o", tmp_path / "twin.toml")
    assert result.exit_code == 0
    assert "actuator lag [ms]" in result.stdout
    assert "warning: " in result.stdout
    assert f"next: gustproof tune {tmp_path / 'twin.toml'}" in result.stdout.replace("\n", "")
    alone = run(flight[0])
    assert alone.stdout.endswith(f"next: gustproof identify log {flight[0]} -o my-quad.toml\n")


def test_axes_at_rest_give_the_manoeuvre_and_no_vehicle(tmp_path):
    time = np.arange(0.0, 30.0, 0.004)
    rows = 1e-3 * np.random.default_rng(1).standard_normal((len(time), 6))
    rows[:, 3:] *= 1e-3
    log = tmp_path / "rest.csv"
    header = "time_s,p_radps,q_radps,r_radps,torque_x_nm,torque_y_nm,torque_z_nm"
    np.savetxt(log, np.column_stack([time, rows]), delimiter=",", header=header, comments="")
    told = run(log, "--json")
    assert told.exit_code == 0, told.output
    document = json.loads(told.stdout)
    assert document["actuator_lag_s"] is None
    assert document["held_out_r2"] == {"roll": None, "pitch": None, "yaw": None}
    assert all("chirp" in document["advice"][axis] for axis in ("roll", "pitch", "yaw"))
    assert "chirp" in one_line(run(log, "-o", tmp_path / "twin.toml"))
    assert not (tmp_path / "twin.toml").exists()


@pytest.mark.parametrize("option", ["-o", "--report", "--wind", "--scenario"])
def test_nothing_is_overwritten(flight, tmp_path, option):
    suffix = {"--report": ".html", "--wind": ".csv"}.get(option, ".toml")
    taken = tmp_path / f"taken{suffix}"
    taken.write_text("mine")
    assert "exists already" in one_line(run(flight[0], option, taken))
    assert taken.read_text() == "mine"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--inertia", "1,2"], "must be three numbers"),
        (["--like", "no-such", "-o", "x.toml"], "no vehicle named 'no-such'"),
        (["--thrust-max", "0.1", "-o", "x.toml"], "thrust_max"),
        (["-o", "x.json"], "ends in .toml"),
    ],
)
def test_bad_options_are_refused_in_one_line(flight, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    assert said in one_line(run(flight[0], *arguments))
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_no_log_is_refused_in_one_line(tmp_path):
    (tmp_path / "log.ulg").write_bytes(b"nonsense")
    assert "log.ulg" in one_line(run(tmp_path / "log.ulg"))
    assert "missing.ulg" in one_line(run(tmp_path / "missing.ulg"))


@pytest.mark.parametrize(
    ("system", "parameters", "words"),
    [
        ("px4", {"MC_ROLL_P": 5.0}, "--from flight.ulg -o {}/q.params"),
        ("px4", {}, "-o {}/q.json"),
        ("betaflight", {"p_roll": 40.0}, "-o {}/q.json"),
    ],
)
def test_the_next_step_starts_from_the_gains_that_flew(capsys, tmp_path, system, parameters, words):
    log = FlightLog(source="x", system=system, gyro=None, parameters=parameters)
    context = SimpleNamespace(params={"log": Path("flight.ulg")})
    _tell_outputs(context, {"vehicle": tmp_path / "q.toml"}, log, has_vehicle=True)
    assert capsys.readouterr().out.endswith(f"next: gustproof tune {tmp_path}/q.toml {words.format(tmp_path)}\n")
