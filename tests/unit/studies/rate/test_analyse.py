import json
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.scoring.metrics import measure
from gustproof.law.form import load_law
from gustproof.show.report import figures
from gustproof.show.report.figure_style import FigureStyle, figures_as
from gustproof.show.report.laws import render_analysis
from gustproof.show.report.terminal import save_text
from gustproof.studies.rate.analyse import analyse
from gustproof.studies.rate.law_margins import axis_robustness, axis_robustness_over_frequency, hover_margins

VEHICLE = load_vehicle("paper")
SHORT = replace(load_scenario("paper-turbulence"), duration_s=10.0)


@pytest.fixture(scope="module")
def scheduled():
    return analyse(load_law("hinf-scheduled"), VEHICLE, SHORT)


def test_the_flown_figures_are_those_of_the_flight(scheduled):
    law = load_law("hinf-scheduled")
    assert scheduled.metrics == measure(fly_direct(SHORT, law, vehicle=VEHICLE, seed=1), VEHICLE, SHORT)


def test_error_of_gusts_and_of_noise_add_up_as_squares(scheduled):
    parts = np.hypot(scheduled.gust_alone.rmse_deg, scheduled.noise_alone.rmse_deg)
    # they are independent, so over ten seconds their product averages out to a tenth
    assert parts == pytest.approx(scheduled.metrics.rmse_deg, rel=0.15)


def test_the_loop_s_curves_agree_with_its_margins(scheduled):
    worst = hover_margins(load_law("hinf-scheduled"), VEHICLE, SHORT)
    assert hover_margins(load_law("hinf-scheduled"), load_vehicle("iris"), SHORT) is None  # unstable there
    assert max(axis.Ms for axis in scheduled.hover.margins.input) == worst.Ms
    S = 1.0 / (1.0 + scheduled.hover.loop)
    # the axes do not couple at hover, so the singular values are the axes' own
    assert np.max(np.abs(S)) == pytest.approx(worst.Ms, rel=5e-3)
    assert np.max(np.abs(S), axis=1) == pytest.approx(scheduled.hover.sensitivities["S"], rel=1e-6)


def test_a_step_is_seen_on_each_axis_and_is_taken_back(scheduled):
    euler = np.abs(scheduled.step_records["q_NB"][:, 1:])
    assert np.all(np.max(euler, axis=0) > 1e-4)
    assert np.all(scheduled.step_records["q_NB"][:100, 0] == 1.0)  # nothing before half a second


def test_json_has_every_part_and_no_infinity(scheduled):
    document = json.loads(json.dumps(scheduled.to_dict(), allow_nan=False))
    assert {"law", "margins", "loop_poles_rad_s", "flown", "gust_alone", "noise_alone", "limits"} <= set(document)
    assert any("Ms 2.6 in yaw" in line for line in document["limits"])


def test_how_far_the_vehicle_may_be_off_is_told_where_axes_do_not_couple(scheduled):
    law = load_law("hinf-scheduled")
    assert axis_robustness(replace(law, D=law.D + 1e-6), VEHICLE, SHORT) == ()
    told = "(rounding bounded) for inertia ±44.5 % and lag ±66.8 % together, yaw unstable at -44.6 % and -66.9 %"
    assert any(told in line for line in scheduled.limits())
    flagship = analyse(load_law("flagship"), VEHICLE, SHORT)
    assert min(axis.certified for axis in flagship.stability) > 1.9
    off_nominal = flagship.to_dict()["off_nominal"]
    assert off_nominal["certified_up_to_times"] == [axis.certified for axis in flagship.stability]
    assert all(1.9 < member["times"] < 2.01 and member["inertia"] < 0.0 for member in off_nominal["unstable_at"])
    limited = "limited to 3, 3, 3 rad/s, so errors beyond 8.01, 7.73, 9.78 deg are flown back at that rate"
    assert any(limited in line and "margins, mu and predictions" in line for line in flagship.limits())
    assert flagship.to_dict()["rate_limit_rad_s"] == [3.0] * 3
    linear = analyse(load_law("hinf-d1"), VEHICLE, SHORT)
    assert any("no limit, a large attitude error may tumble" in line for line in linear.limits())
    assert (linear.to_dict()["rate_limit_rad_s"], linear.to_dict()["attitude_limit_deg"]) == (None, [None] * 3)
    assert any("references: not supported, the law holds level" in line for line in scheduled.limits())
    assert any(
        "certified stable at hover (rounding bounded) for inertia ±39.5 % and lag ±59.3 % together" in line
        for line in flagship.limits()
    )


def test_what_is_possible_at_the_law_s_price_is_told(scheduled):
    found = scheduled.placement
    assert found.Ms == hover_margins(load_law("hinf-scheduled"), VEHICLE, SHORT).Ms
    assert found.least_rmse_deg < found.rmse_deg
    told = (
        f"average over many flights: this law {found.rmse_deg:.3g} deg expected, best linear gyro-only law at the same "
        f"Ms and slew {found.least_rmse_deg:.3g} deg (this flight: {scheduled.metrics.rmse_deg:.3g}, seed 1)"
    )
    assert told in scheduled.limits()
    assert scheduled.to_dict()["place"]["rmse_deg"] == found.rmse_deg


def test_a_law_of_rates_has_no_torque_loop_and_is_flown_all_the_same(tmp_path):
    analysis = analyse(load_law("hinf-rates"), VEHICLE, SHORT)
    assert analysis.hover.margins is None
    assert analysis.to_dict()["margins"] is None
    assert analysis.placement is None
    figures.save_analysis(analysis, (), tmp_path / "rates.png")
    save_text(render_analysis(analysis), tmp_path / "rates.txt")
    assert "commands" in (tmp_path / "rates.txt").read_text()


def test_an_unstable_loop_is_said_first():
    law = load_law("hinf-d2")
    backwards = replace(law, C=-law.C, D=-law.D)
    limits = analyse(backwards, VEHICLE, SHORT).limits()
    assert limits[0] == "the loop is unstable at hover"
    assert not any("bandwidth" in line for line in limits)


def test_analysis_of_a_flight_that_diverges_has_no_nan(tmp_path):
    law = load_law("hinf-d1")
    analysis = analyse(replace(law, A=2.0 * np.eye(9)), VEHICLE, SHORT)
    assert analysis.limits()[:2] == ("the loop is unstable at hover", "the flight diverges: no figures")
    document = json.loads(json.dumps(analysis.to_dict(), allow_nan=False))
    assert document["flown"]["rmse_deg"] is document["noise_alone"]["torque_slew_rms"] is None
    save_text(render_analysis(analysis), tmp_path / "unstable.txt")
    assert "nan" not in (tmp_path / "unstable.txt").read_text()


def test_a_law_that_commands_nothing_is_analysed_without_infinity(tmp_path):
    law = load_law("hinf-d1")
    analysis = analyse(replace(law, **{name: np.zeros_like(getattr(law, name)) for name in "ABCD"}), VEHICLE, SHORT)
    figures.save_analysis(analysis, (), tmp_path / "nothing.png")
    assert not any("inf" in line for line in analysis.limits())
    assert json.loads(json.dumps(analysis.to_dict(), allow_nan=False))["place"]["least_rmse_deg"] is None


def test_the_figure_is_cut_below_what_matters_and_before_half_the_sample_rate(scheduled, drawn, tmp_path):
    figures.save_analysis(scheduled, (), tmp_path / "x.png")
    gain, S, phase, *_ = drawn[0].axes
    for axes in (gain, S, phase):
        assert all(line.get_xdata()[-1] < 0.99 * np.pi / 0.004 for line in axes.lines if len(line.get_xdata()) > 2)
    assert [axes.get_ylim()[0] for axes in (gain, S)] == [-80.0, -40.0]  # dB
    assert all(np.max(np.abs(np.diff(line.get_ydata()))) < 15.0 for line in phase.lines)


def test_the_figure_has_bode_sensitivities_step_and_air(scheduled, drawn, tmp_path):
    found = axis_robustness_over_frequency(load_law("hinf-scheduled"), VEHICLE, SHORT)
    figures.save_analysis(scheduled, found, tmp_path / "x.png")
    gain, S, phase, mu, spread, step, torque, air = drawn[0].axes
    assert [len(axes.lines) for axes in (mu, spread)] == [7, 6]
    proved, sampled = mu.lines[0].get_ydata()[:-1], mu.lines[1].get_ydata()
    assert np.all((sampled <= proved) | np.isnan(sampled))
    assert [len(axes.lines) for axes in (gain, S, phase, step, torque, air)] == [7, 4, 7, 3, 3, 3]
    assert phase.lines[0].get_ydata()[0] <= 0.0
    assert np.ptp(step.lines[0].get_ydata()) > 0.0


def test_a_paper_s_figure_has_the_chosen_panels_with_their_legends_above(scheduled, drawn, tmp_path):
    with figures_as(FigureStyle.PAPER, data=True):
        figures.save_analysis(scheduled, (), tmp_path / "few.png")
        figures.save_analysis(scheduled, (), tmp_path / "x.png", chosen=("sensitivity", "gust"))
    assert [len(figure.axes) for figure in drawn] == [3, 2]
    drawn[1].draw_without_rendering()
    for axes in drawn[1].axes:
        assert not axes.get_title()
        assert axes.get_legend().get_window_extent().y0 >= axes.get_window_extent().y1 - 1.0
    rows = (tmp_path / "x.csv").read_text().count("\n")
    assert 1000 < rows < 4 * 400 + 3 * 2000 + 10  # no curve has more than 2000 points
    with pytest.raises(ConfigError, match="no panel named 'gain'"):
        figures.draw_analysis(scheduled, chosen=("gain",))
    with pytest.raises(ConfigError, match="has no panel 'mu', only loop, sensitivity, phase, step, torque, gust"):
        figures.draw_analysis(scheduled, chosen=("mu",))
