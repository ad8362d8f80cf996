"""Tables and text say what the figures say."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.session.latency import Latency
from gustproof.design.cascades.tuning import TuningLimits
from gustproof.design.tune import Tuning
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.flight.scoring.metrics import Metrics
from gustproof.law.form import load_law
from gustproof.show.report.laws import render_limits, render_tuning
from gustproof.show.report.terminal import render_flight, save_text
from gustproof.show.reproduce.errata import list_choices
from gustproof.show.reproduce.paper_tables import render_background, render_comparison, render_paper
from gustproof.studies.rate.law_margins import HoverMargins, hover_margins
from gustproof.studies.rate.placement import ErrorLimits, Placement, TradeOffCurve

FIGURES = Metrics(
    peak_deg=1.5, rmse_deg=0.25, peak_roll_deg=1.5, peak_pitch_deg=1.0,
    peak_yaw_deg=1.0, peak_settled_deg=1.0, rmse_roll_deg=0.1,
    rmse_pitch_deg=0.1, rmse_yaw_deg=0.1, torque_rms_nm=0.2, torque_peak_nm=0.9, torque_slew_rms=20.0,
    saturated_s=0.0, rho_in_bounds=True, realtime_factor=100.0,
)  # fmt: skip
LAWS = ("pid-default", "pid-fair", "indi", "flagship", "flagship-robust", "hinf-d1", "hinf-scheduled", "hinf-rates")

MARGINS = HoverMargins(
    Ms=1.3, phase_margin_deg=45.0, gain_margin=7.3, delay_margin=0.04, unstable_delay=11, off_nominal_Ms=2.4
)
PLACE = Placement(Ms=1.36, slew=19.9, rmse_deg=0.0819, own_rate=0.0074, own_rate_rmse_deg=0.0417, least_rmse_deg=0.0801)
PLACES = {"flagship": PLACE, "hinf-rates": None}
GYRO = replace(load_vehicle("paper").gyro, snr_db=33.0, reference_rate=0.15)


def written(document) -> str:
    """Return the document as a reader of the saved report sees it, line breaks taken out."""
    with TemporaryDirectory() as folder:
        save_text(document, Path(folder) / "report.txt")
        return " ".join((Path(folder) / "report.txt").read_text().split())


def medians(**changes: Metrics):
    scenarios = ("paper", "paper-turbulence", "coning", "bias")
    return {law: dict.fromkeys(scenarios, changes.get(law.replace("-", "_"), FIGURES)) for law in LAWS}


def test_table_iii_stands_beside_ours():
    text = written(render_paper(medians(hinf_d1=replace(FIGURES, peak_deg=6.66, rmse_deg=1.11))))
    for number in ("30.54", "5.67", "7.12", "1.35", "6.66", "1.11", "1.50", "0.25", "[deg]"):
        assert number in text


@pytest.mark.parametrize("better", ["flagship", "hinf-scheduled", "pid-fair"])
def test_who_is_better_follows_the_figures(better):
    margins = dict.fromkeys(LAWS, MARGINS)
    change = {better.replace("-", "_"): replace(FIGURES, rmse_deg=0.125)}
    text = written(render_comparison(medians(**change), margins, PLACES, GYRO))
    assert f"{better} is better in RMSE (2.00 times less)" in text
    assert "Ms 1.30 (2.40 in the box), gain 7.3, lost at 11 samples of delay" in text


def test_the_least_error_at_its_price_stands_beside_each_law():
    margins = dict.fromkeys(LAWS, MARGINS)
    text = written(render_comparison(medians(), margins, PLACES, GYRO))
    assert "flagship 1.500 1.000 0.250 0.082 0.042 0.080 0.200" in text
    assert "hinf-rates 1.500 1.000 0.250 - - - 0.200" in text


def test_both_levels_of_the_gyro_s_noise_are_told():
    text = written(render_comparison(medians(), dict.fromkeys(LAWS, MARGINS), PLACES, GYRO))
    assert "noise is the vehicle file's: 33 dB under its reference rate, 0.15 rad/s rms" in text
    assert "At its own rate: predicted with noise 33 dB under the rate that the law itself has" in text


def test_a_law_that_knows_no_such_noise_has_no_figure_there():
    places = {"flagship": replace(PLACE, own_rate=None, own_rate_rmse_deg=None)}
    text = written(render_comparison(medians(), dict.fromkeys(LAWS, MARGINS), places, GYRO))
    assert "flagship 1.500 1.000 0.250 0.082 - 0.080 0.200" in text


def test_no_figure_of_the_comparison_is_cut():
    angles = {"peak_deg": 30.54, "peak_settled_deg": 28.31, "rmse_deg": 11.23, "peak_roll_deg": 151.3}
    bad = replace(FIGURES, torque_slew_rms=120.5, **angles)
    margins = dict.fromkeys(
        LAWS, replace(MARGINS, Ms=10.5, off_nominal_Ms=10.75, gain_margin=101.5, unstable_delay=100)
    )
    places = dict.fromkeys(LAWS, replace(PLACE, rmse_deg=11.23, own_rate_rmse_deg=11.24, least_rmse_deg=10.21))
    text = written(render_comparison(medians(flagship_robust=bad), margins, places, GYRO))
    assert "flagship-robust 30.5 28.3 11.2 11.2 11.2 10.2 0.200 120.5 151.3 151.3 10.50 10.75 101.5 100" in text
    assert "…" not in text


def test_limits_are_told_by_what_is_known_and_by_the_peak():
    limits = ErrorLimits(
        scenario="x", slew=20.0, gyro_deg=0.0711, gyro_any_slew_deg=0.0706, clairvoyant_deg=6e-4,
        clairvoyant_any_slew_deg=5e-5,
        curves=(
            TradeOffCurve(slew=10.0, Ms=(1.3601,), rmse_deg=(0.0911,), any_Ms_deg=0.0718),
            TradeOffCurve(slew=20.0, Ms=(1.1502, 1.3599), rmse_deg=(0.1537, 0.08), any_Ms_deg=0.0711),
        ),
    )  # fmt: skip
    text = written(render_limits(limits))
    assert "gyros, the true spectra │ 0.0711 │ 0.0706" in text
    assert "state and air, exactly │ 0.0006 │ 5e-05" in text
    assert "│ 10 │ - │ 0.0911 │ 0.0718 │" in text
    assert "│ 20 │ 0.1537 │ 0.0800 │ 0.0711 │" in text


def test_what_rates_cost_is_told():
    margins = dict.fromkeys(LAWS, MARGINS)
    text = written(render_comparison(medians(hinf_rates=replace(FIGURES, rmse_deg=0.5)), margins, PLACES, GYRO))
    assert "2.00 times" in text


def test_the_choices_are_read_from_the_files_that_were_flown():
    vehicle, scenario = load_vehicle("paper"), load_scenario("paper")
    changed = list_choices(replace(vehicle, actuator_lag=0.123), replace(scenario, delay_samples=7))
    told = " ".join(choice for _, choice in changed)
    assert "0.123 s" in told
    assert "7 sample(s)" in told
    assert "rate damping 0.02 / 0.02 / 0.02 1/s; the rotors' drag gives 0.29 / 0.36 / 1.5 1/s" in told


@pytest.mark.parametrize(("name", "least"), [("flagship", "least: "), ("aided", "least of laws with gyros alone: ")])
def test_limits_of_a_tuning_say_which_side_is_kept(name, least):
    limits = TuningLimits(sensitivity_peak=1.4, slew=20.0, corner_peak=2.38, gain=5.15)
    tuning = Tuning(
        kind=name, law=load_law(name), vehicle="paper", scenario="paper-turbulence", limits=limits, Ms=1.4, slew=20.0,
        rmse=0.001, least_rmse=0.0014, any_Ms_rmse=None, off_nominal_Ms=2.4, phase_margin=0.8, gain_margin=5.12,
        delay_margin=0.04,
    )  # fmt: skip
    text = written(render_tuning(tuning))
    for words in (
        f"{least}0.0802 at",
        "│ ≤ 20 ",
        "│ ≤ 1.4 ",
        "│ ≤ 2.38 is the goal, ",
        "│ ≥ 5.15 is the goal, with 3 % tolerance",
    ):
        assert words in text


def test_the_limits_of_the_results_are_told():
    text = written(render_background(load_vehicle("paper"), load_scenario("paper")))
    assert (
        "gyro bias b turns the vehicle by b t with every law here (scenario `bias`), but with `aided` in yaw alone"
        in text
    )
    assert "Translation is held" in text


def flight(message: str = "x", metrics: Metrics | None = None, timing: Mapping[str, Any] | None = None) -> Any:
    """Return what stands for a flight that was not recorded."""
    nothing = {"estimator_view": None, "requirements": (), "warnings": (), "bag": None}
    return SimpleNamespace(message=message, metrics=metrics, timing=timing, **nothing)


def test_a_flight_that_never_began_has_no_figures():
    assert written(render_flight(flight())) == "x no samples were flown or recorded"


def test_deadlines_of_real_time_are_told():
    lateness = Latency()
    for late_us in (2, 2, 900):
        lateness.add(late_us)
    late = {f"late_{name}": value for name, value in lateness.stats().items()}
    pace = {"missed": 3, "held": 5, **late, "fifo": True}
    told = written(render_flight(flight(timing=pace)))
    assert "missed deadlines 3, repeated set-points 5" in told
    assert "lateness median 2 us, p99 900 us, max 900 us" in told
    assert "at the law" not in told
    samples = {"late_samples": 125, "missed_samples": 0}
    assert "samples at the law: 125 late, 0 missed" in written(render_flight(flight(timing=pace | samples)))


def test_how_a_flight_ended_is_told_in_one_line(tmp_path):
    message = f"paper, hinf-d1, seed 1: {FlightOutcome.CONTROLLER_LOST.value}"
    save_text(render_flight(flight(message=message, metrics=FIGURES)), tmp_path / "told.txt")
    assert (tmp_path / "told.txt").read_text().splitlines()[0] == message


def test_margins_are_those_of_the_worst_axis_and_only_of_torque_laws():
    vehicle, scenario = load_vehicle("paper"), load_scenario("paper")
    margins = hover_margins(load_law("hinf-d1"), vehicle, scenario)
    assert margins is not None
    # Continuous, roll: Ms 1.21, 64 deg, 117 ms; the hold, a sample of delay and the worst axis only take from that.
    assert 1.21 < margins.Ms < 1.45
    assert 45.0 < margins.phase_margin_deg < 64.0
    assert 0.09 < margins.delay_margin < 0.117
    late = hover_margins(load_law("hinf-d1"), vehicle, replace(scenario, delay_samples=3))
    assert late is not None
    # Two samples more take from the delay margin what they are: 2 * 4 ms, to the accuracy of the crossing.
    assert margins.delay_margin - late.delay_margin == pytest.approx(0.008, rel=1e-6)
    assert hover_margins(load_law("hinf-rates"), vehicle, scenario) is None
