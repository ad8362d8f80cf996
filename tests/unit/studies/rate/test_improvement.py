"""Better gains name their cost, stay near the judged torque slew, and stand beside the judged ones where these fail."""

import math
from dataclasses import replace
from types import SimpleNamespace

import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.uncertainty import load_vehicle_set
from gustproof.design.loops.models import AUTOPILOTS, autopilot_law
from gustproof.design.tune import default_slew
from gustproof.show.report.judgement import iter_comparison
from gustproof.studies.rate import judge as judging
from gustproof.studies.rate.improvement import Improvement, weigh
from gustproof.studies.rate.judge import Verdict, improve, judge_law

AIR = replace(load_scenario("paper-turbulence"), duration_s=10.0)
IRIS = load_vehicle_set("iris")


@pytest.fixture(scope="module")
def stock():
    """Return the judgement of PX4's defaults; proof, limit, advice and a long search have tests of their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(judging, "_FLIGHTS", 100)
        patch.setattr(judging, "_SEARCH_S", 1.0)
        patch.setattr(judging, "_prove", lambda *_: (None, "left out"))
        patch.setattr(judging, "_least_error", lambda *_: None)
        patch.setattr(judging, "advise", lambda *_, **__: ())
        return judge_law(autopilot_law("px4", {}, IRIS.nominal).law, IRIS, AIR)


def changed(found, *, slew=1.0, error=1.0, Ms=1.0, **others):
    """Return the judgement with figures that many times as large."""
    axes = [replace(axis, Ms_found=Ms * axis.Ms_found, Ms_proved=Ms * axis.Ms_proved) for axis in found.axes]
    predicted = replace(found.predicted, rmse=error * found.predicted.rmse)
    return replace(found, slew=slew * found.slew, predicted=predicted, axes=tuple(axes), **others)


def weighed(now, better, flown=None):
    return Improvement(now=now, better=better, where_now_fails=flown)


@pytest.mark.parametrize(
    ("change", "title"),
    [
        ({"error": 0.5, "slew": 16.3}, "Less error, for 16.3 times the torque slew"),
        (
            {"error": 0.5, "slew": 2.0, "Ms": 1.35},
            "Less error, for 2 times the torque slew and 1.35 times the Ms over the spreads",
        ),
        ({"error": 0.5, "slew": 0.5}, "Less error, less torque slew"),
        ({"error": 1.1, "Ms": 0.8}, "Less Ms over the spreads, for 1.1 times the error"),
    ],
)
def test_the_title_names_what_gets_better_and_what_it_costs(stock, change, title):
    assert weighed(stock, changed(stock, **change)).describe() == title


def test_a_better_verdict_is_named_and_a_worse_one_or_nothing_better_is_no_improvement(stock):
    fragile = changed(stock, verdict=Verdict.FRAGILE)
    assert weigh(fragile, stock, 1).describe() == "Sound in place of fragile"
    assert weigh(stock, changed(fragile, error=0.5), 1) is None
    assert weigh(stock, changed(stock, slew=1.5), 1) is None


def test_better_gains_are_searched_within_twice_the_torque_slew(stock, monkeypatch):
    asked = []

    def tune(_kind, _vehicles, _scenario, *, slew, sensitivity_peak, flown):
        asked.append(slew)
        assert flown == stock.law.provenance.parameters
        return SimpleNamespace(law=stock.law, Ms=sensitivity_peak, slew=1.1 * slew, rmse=0.5 * stock.predicted.rmse)

    monkeypatch.setattr(judging, "tune_gains", tune)
    assert default_slew(IRIS.nominal, AIR) > 10.0 * stock.slew
    assert improve(stock, IRIS) is None, "all found are above the limit"
    assert max(asked) == pytest.approx(2.0 * stock.slew)
    monkeypatch.setattr(judging, "tune_gains", lambda *given, **limits: replace_slew(tune(*given, **limits)))
    assert improve(stock, IRIS).slew < 2.0 * stock.slew
    eager = changed(stock, slew=1000.0)
    asked.clear()
    assert improve(eager, IRIS) is not None
    assert max(asked) == pytest.approx(eager.slew)


def replace_slew(tuned):
    return SimpleNamespace(**{**vars(tuned), "slew": 0.9 * tuned.slew})


def test_sound_gains_are_not_bettered_by_more_error_at_the_same_margins(stock, monkeypatch):
    worse = SimpleNamespace(law=stock.law, Ms=1.2 * stock.Ms, slew=stock.slew, rmse=1.2 * stock.predicted.rmse)
    monkeypatch.setattr(judging, "tune_gains", lambda *_, **__: worse)
    assert improve(stock, IRIS) is None
    assert improve(changed(stock, verdict=Verdict.FRAGILE), IRIS) is worse


def test_both_fly_where_the_judged_ones_fail(stock):
    found = weigh(stock, changed(stock, error=0.5), 1)
    assert found.where_now_fails == stock.failure.figures
    told = found.to_dict()["where_now_fails"]
    assert told["now_peak_deg"] == told["better_peak_deg"] == stock.failure.figures.peak_deg
    peaks = dict(iter_comparison(found))["peak where it fails now [deg]"]
    assert peaks[0] == peaks[1] == f"{stock.failure.figures.peak_deg:.3g}"
    lost = replace(stock.failure.figures, peak_roll_deg=math.nan, peak_deg=math.nan)
    assert dict(iter_comparison(weighed(stock, stock, lost)))["peak where it fails now [deg]"][1] == "attitude is lost"
    assert weighed(stock, stock, lost).to_dict()["where_now_fails"]["better_peak_deg"] is None


def test_the_margins_of_both_stand_side_by_side(stock):
    axis = stock.axes[0]
    late = replace(axis, worst=replace(axis.worst, delay_margin=0.0123))
    rows = dict(iter_comparison(weighed(stock, replace(stock, axes=(late, *stock.axes[1:])))))
    least = 1e3 * min(each.nominal.delay_margin for each in stock.axes)
    assert rows["delay [ms], nominal; worst corner"][1] == f"{least:.3g}; 12.3"
    assert {name.split(",")[0] for name in rows} >= {"phase [deg]", "gain up", "gain down", "delay [ms]"}
    assert dict(iter_comparison(weighed(replace(stock, axes=()), stock)))["gain up, nominal; worst corner"][0] == "-"


@pytest.mark.parametrize(
    ("kind", "name", "value", "words"),
    [
        ("px4", "MC_ROLL_P", 12.0, "PX4's limit"),
        ("px4", "MC_YAW_P", 4.9999, "PX4's limit"),
        ("px4", "MC_PITCHRATE_P", 0.7, "above PX4's limit, 0.6"),
        ("px4", "MC_ROLL_P", 11.0, ""),
        ("px4", "MC_ROLLRATE_I", 48.0, ""),
        ("ardupilot", "ATC_RAT_YAW_I", 64.0, "above ArduPilot's limit, 1"),
        ("ardupilot", "ATC_RAT_RLL_I", 16.0, "above ArduPilot's limit, 2"),
        ("ardupilot", "ATC_ANG_PIT_P", 2.0, "below ArduPilot's limit, 3"),
    ],
)
def test_a_value_at_a_documented_limit_says_so(kind, name, value, words):
    assert AUTOPILOTS[kind].describe_limit(name, value) == words


def test_limits_stand_in_the_table_and_in_json(stock):
    law = autopilot_law("px4", {"MC_ROLL_P": 12.0}, IRIS.nominal).law
    found = weighed(stock, replace(stock, law=law))
    assert dict(iter_comparison(found))["MC_ROLL_P"] == ("6.5", "12: PX4's limit")
    assert found.to_dict()["at_limits"] == ["MC_ROLL_P 12: PX4's limit"]


def test_documented_values_are_parameters_of_the_loops_within_what_is_taken():
    for autopilot in AUTOPILOTS.values():
        for name, limits in autopilot.documented.items():
            low, high = autopilot.settings[name][1:]
            assert all(low <= limit <= high for limit in limits if limit is not None), name
