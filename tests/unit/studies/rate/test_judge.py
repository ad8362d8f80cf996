"""Verdicts with their evidence: sound, fragile and unstable gains, shown to be so in flight."""

import json
import math
from dataclasses import astuple, replace
from types import SimpleNamespace

import numpy as np
import pytest

from firmware_model.config.parameter_files import read_parameters
from firmware_model.config.scenario import load_scenario
from firmware_model.config.spreads import take_nominal
from firmware_model.config.uncertainty import load_vehicle_set, make_vehicle_set
from gustproof.airframe.hover import is_stable_at_hover
from gustproof.design.loops.models import autopilot_law
from gustproof.design.tune import default_slew
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.scoring.metrics import measure
from gustproof.law.form import load_law
from gustproof.robust.lti.margins import LoopMargins
from gustproof.show.report.judgement import describe_spread_peak
from gustproof.studies.rate import judge as judging
from gustproof.studies.rate.judge import SPARE_DELAY, Verdict, air_budget, improve, judge_law, scenario_for
from gustproof.studies.rate.law_margins import hover_margins
from gustproof.studies.rate.plant_box import plant_box

AIR = load_scenario("paper-turbulence")
PAPER = load_vehicle_set("paper")
MEASURED = {
    ("px4", "stock"): 0.189,
    ("px4", "tuned"): 0.068,
    ("ardupilot", "stock"): 0.593,
    ("ardupilot", "tuned"): 0.082,
}
"""[deg] error by their own estimate of real autopilots in flight, as the guide has them."""


def gains(kind: str, name: str, **changes: float) -> dict[str, float]:
    return {key: float(value) for key, value in read_parameters(name, kind).items()} | changes


def slow_motors() -> SimpleNamespace:
    lag = {"nominal": 0.12, "low": 0.084, "high": 0.156}
    return make_vehicle_set({**PAPER.document, "actuator_lag": lag}, "slow")


TUNED = gains("px4", "tuned")
FRAGILE = {
    "too much P": ({**TUNED, "MC_ROLLRATE_P": 1.0, "MC_PITCHRATE_P": 0.82}, PAPER),
    "D filter far too low": ({**TUNED, "IMU_DGYRO_CUTOFF": 2.0}, PAPER),
    "slow motors": (TUNED, slow_motors()),
}


@pytest.fixture(scope="module")
def judge():
    """Return what judges quickly and keeps results: a short search; no proof, limit or advice, which have own tests."""
    kept = {}

    def judged(key, law, vehicles=PAPER, scenario=AIR):
        if key not in kept:
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(judging, "_FLIGHTS", 100)
                patch.setattr(judging, "_SEARCH_S", 2.0)
                patch.setattr(judging, "_prove", lambda *_: (None, "left out"))
                patch.setattr(judging, "_least_error", lambda *_: None)
                patch.setattr(judging, "advise", lambda *_, **__: ())
                kept[key] = judge_law(law, vehicles, scenario)
        return kept[key]

    return judged


@pytest.fixture(scope="module")
def tuned(judge):
    return judge("tuned", autopilot_law("px4", TUNED, PAPER.nominal).law)


def judge_fragile(judge, case):
    parameters, vehicles = FRAGILE[case]
    return judge(case, autopilot_law("px4", parameters, vehicles.nominal).law, vehicles)


@pytest.mark.slow
def test_a_sound_law_has_a_proof_and_a_worst_gust():
    found = judge_law(load_law("flagship"), PAPER, replace(AIR, duration_s=10.0))
    assert (found.verdict, found.is_proved, len(found.reasons)) == (Verdict.SOUND, True, 1)
    assert "proved for all of them" in found.reasons[0]
    assert found.proof is not None
    assert found.proof.proven
    assert "inertia within 20 %" in found.proof.statement
    assert found.gust is not None
    assert found.gust.peak_deg < max(found.proof.estimate_deg)
    assert found.least_rmse_deg < found.rmse_deg < found.worst_rmse_deg
    document = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert document["verdict"] == "sound"
    assert document["axes"]["roll"]["Ms_proved"] == found.axes[0].Ms_proved


@pytest.mark.slow
def test_the_proved_peak_covers_every_vehicle_in_the_spreads(tuned):
    rng, low, high = np.random.default_rng(3), np.array(tuned.box.low), np.array(tuned.box.high)
    peaks = []
    for _ in range(12):
        inertia = tuple((low + (high - low) * rng.random(3)).tolist())
        vehicle = replace(tuned.vehicle, inertia_B=inertia, actuator_lag=float(rng.uniform(*tuned.box.lag)))
        peaks.append(hover_margins(tuned.law, vehicle, tuned.scenario).Ms)
    proved = max(axis.Ms_proved for axis in tuned.axes)
    assert max(peaks) <= proved
    assert proved == tuned.Ms_over_spreads < 1.01 * max(axis.Ms_found for axis in tuned.axes)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "name"), list(MEASURED))
def test_predicted_error_is_that_of_real_flights(judge, kind, name):
    found = judge((kind, name), autopilot_law(kind, gains(kind, name), PAPER.nominal).law)
    assert found.seen_rmse_deg == pytest.approx(MEASURED[kind, name], rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("case", list(FRAGILE))
def test_gains_made_fragile_are_called_so_and_fail_where_sound_ones_fly(judge, tuned, case):
    found = judge_fragile(judge, case)
    assert found.verdict is not Verdict.SOUND
    failure = found.failure
    sound = tuned.law if case != "slow motors" else improve(found, FRAGILE[case][1]).law
    others = measure(
        fly_direct(failure.scenario, sound, vehicle=failure.vehicle), failure.vehicle, failure.scenario, 0.0
    )
    assert failure.figures.saturated_s > 10.0
    assert failure.figures.torque_slew_rms > 5.0 * failure.nominal.torque_slew_rms or case == "slow motors"
    assert others.saturated_s < 0.1
    assert others.peak_deg < 0.4 * failure.figures.peak_deg
    if case == "slow motors":
        assert failure.figures.peak_roll_deg > 90.0
        assert "attitude is lost" in failure.describe()


def test_each_reason_names_what_is_beyond_its_threshold(judge):
    reasons = judge_fragile(judge, "D filter far too low").reasons
    assert any(reason.startswith("yaw: Ms 5.57, above 2") for reason in reasons)
    assert any("over the spreads, above 2.5" in reason for reason in reasons)
    assert any(reason.endswith("a sample and 5 ms is 9 ms") for reason in reasons)


def test_a_law_for_another_vehicle_is_unstable_and_has_no_figures(judge):
    found = judge("iris", load_law("pid-fair"), load_vehicle_set("iris"))
    assert (found.verdict, found.axes, found.predicted, found.gust) == (Verdict.UNSTABLE, (), None, None)
    assert found.reasons == ("unstable with the nominal vehicle (5 of 5 tried are)",)
    assert found.failure.figures.saturated_s > 30.0
    json.dumps(found.to_dict(), allow_nan=False)


def test_unstable_within_the_spreads_alone_is_unstable(judge):
    law = autopilot_law("px4", {name: 2.5 * value if "RATE_" in name else value for name, value in TUNED.items()},
                        PAPER.nominal).law  # fmt: skip
    found = judge("corner", law)
    assert found.verdict is Verdict.UNSTABLE
    assert "1 of 5 tried" in found.reasons[0]
    assert is_stable_at_hover(law, PAPER.nominal, found.scenario)
    assert not is_stable_at_hover(law, found.failure.vehicle, found.scenario)
    assert found.worst_rmse_deg is None


def test_what_is_sampled_is_not_called_proved(judge):
    found = judge("aided", load_law("aided"))
    assert (found.verdict, found.is_proved) == (Verdict.SOUND, False)
    assert "sampled at 5 vehicles, not proved" in found.reasons[0]
    assert found.to_dict()["stability_over_spreads"] == "sampled"
    assert [axis.Ms_proved for axis in found.axes] == [None] * 3


@pytest.mark.slow
def test_delay_alone_makes_a_law_fragile(judge):
    law = load_law("flagship")
    margin = hover_margins(law, PAPER.nominal, AIR).delay_margin
    late = AIR.delay_samples + int((margin - SPARE_DELAY) / law.dt)
    found = judge("late", law, PAPER, replace(AIR, delay_samples=late))
    assert found.verdict is not Verdict.SOUND
    assert found.axes[0].nominal.delay_margin < margin


def test_gusts_that_cost_the_attitude_make_a_law_fragile(judge):
    found = judge("slow", load_law("pid-default"))
    assert found.verdict is Verdict.FRAGILE
    assert found.is_proved
    assert any("costs the attitude" in reason for reason in found.reasons)


def test_spreads_are_those_of_the_file_or_said_to_be_assumed():
    document = {**PAPER.document, "actuator_lag": {"nominal": 0.05, "low": 0.045, "high": 0.08}}
    box = plant_box(make_vehicle_set(document, "uneven"))
    centre, spreads = box.centre(1)
    assert (box.lag, box.assumed) == ((0.045, 0.08), False)
    assert centre.actuator_lag * (1.0 + spreads.actuator_lag) == pytest.approx(0.08)
    assert centre.inertia_B[1] * (1.0 - spreads.inertia) == pytest.approx(0.16)
    assert box.shares().actuator_lag == pytest.approx(0.6)
    assert len(box.corners()) == 4
    without = make_vehicle_set(take_nominal(PAPER.document, "paper"), "paper")
    assert astuple(plant_box(without).shares()) == pytest.approx((0.2, 0.3))
    assert plant_box(without).describe().endswith("(assumed: the file has no spreads)")


def test_the_budget_is_three_deviations_of_the_moment_flown():
    found = np.array(air_budget(PAPER.nominal, AIR))
    long = replace(AIR, duration_s=600.0)
    flown = fly_direct(long, load_law("pid-fair"), vehicle=PAPER.nominal)["moment_B"]
    assert 3.0 * np.std(flown, axis=0) == pytest.approx(found, rel=0.15)


@pytest.mark.slow
def test_better_gains_keep_the_price_are_sound_and_no_better_than_themselves(judge, monkeypatch):
    found = judge_fragile(judge, "D filter far too low")
    better = improve(found, PAPER)
    again = judge("better", better.law)
    monkeypatch.setattr(judging, "tune_gains", lambda *_, **__: better)
    assert (improve(found, PAPER), improve(again, PAPER)) == (better, None)
    assert again.verdict is Verdict.SOUND
    assert again.seen_rmse_deg < found.seen_rmse_deg
    assert again.slew <= 1.001 * default_slew(PAPER.nominal, AIR)


def test_a_law_of_rates_and_still_air_are_refused():
    with pytest.raises(ValueError, match="'hinf-rates' commands rates"):
        judge_law(load_law("hinf-rates"), PAPER, AIR)
    with pytest.raises(ValueError, match="no turbulence"):
        judge_law(load_law("pid-fair"), PAPER, load_scenario("coning"))


def test_the_scenario_takes_the_law_s_rate():
    law = autopilot_law("ardupilot", {}, PAPER.nominal).law
    found = scenario_for(law, PAPER.nominal, AIR)
    assert (found.control_rate_hz, math.isclose(found.dt, law.dt)) == (400, True)


@pytest.mark.parametrize(
    ("found", "proved", "told"),
    [
        (3.07, 3.08, ["Ms 3.07 over the spreads, above 2.5"]),
        (2.48, 2.53, ["Ms above 2.5 over the spreads is not ruled out, 2.48 is found"]),
        (2.48, None, []),
        (2.4, 2.45, []),
    ],
)
def test_a_bound_is_no_estimate_in_a_reason(found, proved, told):
    margins = LoopMargins(
        crossover=10.0, phase_margin=1.0, gain_margin=3.0, gain_reduction_margin=0.2, delay_margin=0.05, Ms=1.5
    )
    axis = judging.AxisJudgement(
        nominal=margins, worst=margins, Ms_found=found, Ms_proved=proved, rmse_deg=1.0, slew=1.0
    )
    assert [*judging._find_weakness(axis, 0.009)] == told


def test_a_proved_peak_is_shown_rounded_up():
    shown = [
        describe_spread_peak(SimpleNamespace(Ms_over_spreads=peak, is_proved=proved))
        for peak, proved in ((3.0712, True), (3.0712, False), (None, False))
    ]
    assert shown == ["≤ 3.08", "3.07", "-"]
