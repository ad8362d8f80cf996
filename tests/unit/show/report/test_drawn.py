"""Results show, draw and tabulate themselves, as a notebook asks for it."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from firmware_model.config.scenario import load_scenario
from firmware_model.config.uncertainty import load_vehicle_set
from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from gustproof import Campaign, analyse, compute_statistics, fly, fly_campaign, fly_controller, fly_direct, process_pool
from gustproof.flight.routes.flight import Flight
from gustproof.law.form import load_law

SCENARIO = load_scenario("gust-roll")
LAW = load_law("flagship")
MINE, YOURS = replace(LAW, name="mine"), replace(LAW, name="yours")


@pytest.fixture(scope="module")
def flight() -> Flight:
    return fly_controller(SCENARIO, LAW)


def test_records_of_each_route_are_one_array_that_shows_itself(flight: Flight) -> None:
    direct = fly_direct(SCENARIO, LAW)
    assert direct.tobytes() == flight.records.tobytes() == fly(SCENARIO, LAW).records.tobytes()
    assert type(direct["q_NB"]) is type(direct[["q_NB"]]) is np.ndarray
    assert str(direct[10:]).startswith("flagship: 2490 samples, 9.96 s\n")
    assert str(pickle.loads(pickle.dumps(direct))).startswith("flight: 2500 samples")
    assert str(direct[:0]) == "flagship: no samples"
    assert str(direct == direct) == str(np.asarray(direct == direct))


def test_a_table_has_the_numbers_of_the_records_and_euler_angles(flight: Flight) -> None:
    table = flight.to_arrow()
    assert table.num_rows == 2500
    assert table["time_s"].to_numpy()[-1] == pytest.approx(9.996)
    assert np.abs(table["roll_deg"].to_numpy()).max() == flight.metrics.peak_roll_deg  # type: ignore[union-attr]
    assert table["omega_B.z"].to_numpy().tolist() == flight.records["omega_B"][:, 2].tolist()
    octo = fly_direct(SCENARIO, MINE, vehicle=load_vehicle("octo")).to_arrow()
    assert [name for name in octo.column_names if "rotors" in name] == [f"rotors.{i}" for i in range(1, 9)]


def test_flights_of_own_laws_are_drawn_in_colours_of_their_own(flight: Flight) -> None:
    figure = flight.plot(fly_direct(SCENARIO, MINE), fly_direct(SCENARIO, YOURS), fly_direct(SCENARIO, YOURS))
    assert [text.get_text() for text in figure.legends[0].texts] == ["flagship", "mine", "yours", "yours (4)"]
    assert len({to_rgb(line.get_color()) for line in figure.axes[0].lines}) == 4
    assert figure._repr_png_().startswith(b"\x89PNG")  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match="no kind 'angles' of a figure: euler-angles, body-rates, torques"):
        flight.plot(kind="angles")


def test_a_campaign_shows_draws_and_tabulates_itself(tmp_path) -> None:
    plan = Campaign(scenario=SCENARIO, laws=(LAW, MINE), vehicles=load_vehicle_set("paper"), spreads={}, cases=4)
    with process_pool(1) as pool:
        fly_campaign(plan, tmp_path / "mc.parquet", pool)
    found = compute_statistics(tmp_path / "mc.parquet")
    assert str(plan).splitlines()[1:3] == ["laws: flagship, mine", "cases: 4 of each, seed 1"]
    assert str(found).splitlines()[0] == "gust-roll, vehicle paper: 4 cases"
    assert found.to_arrow().num_rows == 8
    assert [axes.get_xlabel() for axes in found.plot().axes] == ["RMSE [deg]", "peak [deg]"]


def test_flights_make_the_page_of_the_command(flight: Flight, tmp_path) -> None:
    flight.report(tmp_path / "a.html", fly_controller(SCENARIO, MINE), fly_controller(SCENARIO, MINE, seed=2))
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert all(name in page for name in ("flagship, seed 1", "mine, seed 1", "mine, seed 2"))
    with pytest.raises(ConfigError, match="13 flights, a report shows at most 12"):
        flight.report(tmp_path / "b.html", *[flight] * 12)


def test_what_is_long_as_numbers_is_short_as_text(flight: Flight) -> None:
    analysis = analyse(LAW, load_vehicle("paper"), SCENARIO)
    for result in (LAW, flight, analysis, flight.metrics, flight.requirements[0]):
        assert 1 <= len(repr(result).splitlines()) <= 10
        assert result._repr_html_().count("<tr>") <= 40  # type: ignore[union-attr]
    assert len(analysis.plot().axes) == 6


def test_a_law_of_no_shipped_vehicle_needs_one() -> None:
    nobody = replace(LAW, provenance=replace(LAW.provenance, vehicle="mine"))
    with pytest.raises(ValueError, match="'flagship' is a law of no shipped vehicle: vehicle must be given"):
        fly_direct(SCENARIO, nobody)
