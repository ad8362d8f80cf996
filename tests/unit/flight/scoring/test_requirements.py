"""Requirements against flights whose figures are known by hand."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.events import AttitudeReference
from firmware_model.config.files import validate
from firmware_model.config.requirement import Metric, Requirement
from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from firmware_model.recording.journal import RECORD
from gustproof.airframe.lpv import PARAMETERS, scheduling_parameters
from gustproof.flight.scoring import requirements
from gustproof.flight.scoring.metrics import measure
from gustproof.flight.scoring.requirements import RequirementResult, judge, reads_share, requirement_label, verdict

VEHICLE = load_vehicle("paper")
SCENARIO = replace(load_scenario("calm"), duration_s=4.0)
ROUNDING = 1e-12  # relative: a few operations in double precision


def flight(n: int = 1000):
    records = np.zeros(n, dtype=RECORD)
    records["time_us"] = np.arange(n) * 4000
    records["q_NB"][:, 0] = 1.0
    return records


def turn(records, axis: int, degrees) -> None:
    half = np.radians(degrees) / 2.0 * np.ones(len(records))
    records["q_NB"][:, 0], records["q_NB"][:, 1 + axis] = np.cos(half), np.sin(half)


def judged(records, scenario: Scenario = SCENARIO, **table) -> RequirementResult:
    requirement = validate(
        Requirement, table if {"at_most", "at_least"} & set(table) else {**table, "at_most": 1.0}, ""
    )
    [result] = judge(records, replace(scenario, require=(requirement,)), VEHICLE)
    return result


def test_without_requirements_nothing_is_judged():
    assert judge(flight(), SCENARIO, VEHICLE) == ()


def test_the_whole_flight_gives_the_figures_of_every_flight():
    records = flight()
    rng = np.random.default_rng(1)
    records["q_NB"] = rng.normal(size=(1000, 4)) * 0.05 + (1.0, 0.0, 0.0, 0.0)
    records["q_NB"] /= np.linalg.norm(records["q_NB"], axis=1, keepdims=True)
    records["torque_command_B"] = rng.normal(size=(1000, 3)) * np.array(VEHICLE.torque_limit)
    figures = measure(records, VEHICLE, SCENARIO, 1.0)
    for name in ("peak_deg", "rmse_deg", "torque_rms_nm", "torque_peak_nm", "torque_slew_rms", "saturated_s"):
        assert judged(records, metric=name).value == pytest.approx(getattr(figures, name), rel=ROUNDING)
    for axis in ("roll", "pitch", "yaw"):
        for name in ("peak", "rmse"):
            value = judged(records, metric=f"{name}_deg", axis=axis).value
            assert value == pytest.approx(getattr(figures, f"{name}_{axis}_deg"), rel=ROUNDING)


def test_a_flight_in_blocks_is_judged_as_the_whole(monkeypatch):
    records, scenario = excursion(300, 400), replace(SCENARIO, event=(STEP,))
    tables = [{"metric": "peak_deg", "axis": axis, "from_s": 1.5} for axis in ("pitch", "yaw")]
    tables.append({"metric": "settling_s", "axis": "yaw", "within_deg": 1.0})
    whole = [judged(records, scenario, **table).value for table in tables]
    monkeypatch.setattr(requirements, "record_blocks", lambda each: np.array_split(each, 3))
    assert [judged(records, scenario, **table).value for table in tables] == whole == pytest.approx([10.0, 2.0, 1.6])


@pytest.mark.parametrize("axis", range(3))
def test_a_torque_of_exactly_the_limit_of_an_axis_is_at_it(axis):
    records = flight()
    records["torque_command_B"][:250, axis] = VEHICLE.torque_limit[axis]
    assert judged(records, metric="saturated_s").value == pytest.approx(1.0)


@pytest.mark.slow
@pytest.mark.parametrize(("from_s", "to_s", "peak"), [(0.0, 1.0, 1.0), (1.0, 2.0, 5.0), (1.004, 2.0, 1.0)])
def test_a_window_has_its_first_sample_and_not_its_last(from_s, to_s, peak):
    records = flight()
    angle = np.ones(1000)
    angle[[250, 500]] = 5.0
    turn(records, 0, angle)
    result = judged(records, metric="peak_deg", from_s=from_s, to_s=to_s)
    assert result.value == pytest.approx(peak, rel=1e-9)


@pytest.mark.parametrize(
    ("limits", "margin", "held"),
    [
        ({"at_most": 5.0}, 2.0, True),
        ({"at_most": 2.0}, -1.0, False),
        ({"at_least": 2.5}, 0.5, True),
        ({"at_least": 4.0}, -1.0, False),
        ({"at_least": 2.5, "at_most": 5.0}, 0.5, True),
        ({"at_least": 1.0, "at_most": 2.0}, -1.0, False),
    ],
)
def test_the_margin_is_to_the_nearer_limit(limits, margin, held):
    records = flight()
    turn(records, 1, 3.0)
    result = judged(records, metric="peak_deg", **limits)
    assert result.margin == pytest.approx(margin, rel=1e-9)
    assert result.is_met is held


def test_a_window_that_was_not_flown_to_its_end_holds_nothing():
    whole, cut_off = flight(500), flight(499)
    assert judged(whole, metric="peak_deg", to_s=2.0).is_met
    result = judged(cut_off, metric="peak_deg", to_s=2.0)
    assert math.isnan(result.value)
    assert not result.is_met
    assert not judged(cut_off, metric="peak_deg", to_s=2.0, at_least=0.0).is_met
    assert not result.judged
    assert verdict(result)[0] == "not judged"
    assert result.to_dict()["judged"] is False


@pytest.mark.parametrize(
    ("table", "label"),
    [
        ({"metric": "peak_deg"}, "peak [deg]"),
        ({"metric": "settling_s", "axis": "yaw", "within_deg": 1.5}, "settling, yaw within 1.5 deg [s]"),
    ],
)
def test_label_names_metric_axis_band_and_unit(table, label):
    assert requirement_label(judged(flight(2), **table).requirement) == label


@pytest.mark.slow
def test_verdict_says_failed_of_what_was_flown_alone():
    records = flight(1000)
    assert verdict(judged(records, metric="peak_deg", at_most=1.0))[0] == "held"
    turn(records, 0, np.full(1000, 3.0))
    assert verdict(judged(records, metric="peak_deg", at_most=1.0))[0] == "FAILED"


def excursion(begin: int, end: int):
    records = flight()
    angle = np.zeros(1000)
    angle[begin:end] = -2.0
    turn(records, 2, angle)
    return records


def test_recovery_counts_from_leaving_the_band_settling_from_the_windows_begin():
    records = excursion(300, 400)
    for metric, value in (("recovery_s", 0.4), ("settling_s", 0.6)):
        result = judged(records, metric=metric, within_deg=1.0, from_s=1.0)
        assert result.value == pytest.approx(value, rel=ROUNDING)
        assert judged(records, metric=metric, within_deg=3.0).value == 0.0
        assert judged(records, metric=metric, within_deg=1.0, axis="roll").value == 0.0
        for end in (1, 100):  # the first sample alone counts, too
            at_once = judged(excursion(0, end), metric=metric, within_deg=1.0)
            assert at_once.value == pytest.approx(0.004 * end, rel=ROUNDING)


@pytest.mark.slow
def test_what_is_outside_at_the_end_never_settles_nor_recovers():
    records = excursion(300, 1000)
    for metric in ("recovery_s", "settling_s"):
        result = judged(records, metric=metric, within_deg=1.0)
        assert result.value == math.inf
        assert not result.is_met


def test_rho_uses_up_its_room_where_the_flight_leaves_table_ii():
    for phi, theta, p, q, r in np.random.default_rng(2).uniform(-2.0, 2.0, (300, 5)):
        rho = scheduling_parameters((phi, 0.75 * theta, 0.0), (p, q, r))
        (cos_roll, cos_pitch), (sin_roll, sin_pitch) = (
            f(np.array((phi, 0.75 * theta)) / 2.0) for f in (np.cos, np.sin)
        )
        records = flight(10)
        records["q_NB"][7] = cos_pitch * cos_roll, cos_pitch * sin_roll, sin_pitch * cos_roll, -sin_pitch * sin_roll
        records["omega_B"][7] = p, q, r
        inside = all(each.low <= value <= each.high for each, value in zip(PARAMETERS, rho, strict=True))
        assert (judged(records, metric="rho_share", to_s=0.04).value <= 1.0) == inside
    records = flight()
    records["omega_B"][7, 2] = -0.75
    assert judged(records, metric="rho_share").value == pytest.approx(0.5, rel=ROUNDING)
    turn(records, 0, 60.0)
    assert judged(records, metric="rho_share").value == pytest.approx(math.sin(math.pi / 3.0), rel=1e-9)


@pytest.mark.slow
def test_drift_is_the_distance_from_where_the_window_begins():
    records = flight()
    records["position_N"] = (100.0, -40.0, -10.0)
    records["position_N"][500:750] += (2.0, -3.0, 6.0)
    assert judged(records, metric="drift_m", from_s=1.0).value == pytest.approx(7.0, rel=ROUNDING)
    assert judged(records, metric="drift_m", from_s=3.0).value == 0.0


def test_a_result_is_json_even_where_it_is_no_number():
    told = judged(excursion(300, 1000), metric="recovery_s", within_deg=1.0, at_most=0.5).to_dict()
    assert told == {
        "metric": "recovery_s", "axis": None, "from_s": 0.0, "to_s": None, "within_deg": 1.0,
        "at_most": 0.5, "at_least": None, "value": None, "margin": None, "judged": True, "held": False,
    }  # fmt: skip
    assert json.loads(json.dumps(told, allow_nan=False)) == told


STEP = AttitudeReference(kind="attitude", at_s=1.0, euler_deg=(0.0, -10.0, 0.0))


@pytest.mark.slow
def test_what_is_asked_for_is_no_error():
    records = flight()
    asked = np.where(np.arange(1000) < 250, 0.0, -10.0)
    turn(records, 1, asked)
    scenario = replace(SCENARIO, event=(STEP,))
    assert judged(records, scenario, metric="peak_deg").value == pytest.approx(0.0, abs=1e-9)
    assert judged(records, metric="peak_deg").value == pytest.approx(10.0, rel=1e-9)


@pytest.mark.parametrize(("furthest", "percent"), [(-9.0, 0.0), (-10.0, 0.0), (-12.5, 25.0)])
@pytest.mark.parametrize("at_s", [0.0, 1.0])
def test_overshoot_is_the_part_of_the_step_beyond_the_new_reference(furthest, percent, at_s):
    records = flight()
    angle = np.full(1000, -8.0)
    angle[:250] = 3.0  # on the other side
    angle[600] = furthest
    turn(records, 1, angle)
    scenario = replace(SCENARIO, event=(replace(STEP, at_s=at_s),))
    result = judged(records, scenario, metric="overshoot_percent", axis="pitch", from_s=at_s, at_most=20.0)
    assert result.value == pytest.approx(percent, abs=1e-9)
    assert result.is_met == (percent <= 20.0)


def test_overshoot_counts_from_the_reference_before_its_window_to_the_one_at_its_end():
    records, steps = flight(), ((0.996, -5.0), (1.0, -10.0), (1.996, -9.0), (2.0, -20.0))
    turn(records, 1, np.where(np.arange(1000) == 300, -12.5, -9.0))
    scenario = replace(SCENARIO, event=tuple(replace(STEP, at_s=at, euler_deg=(0.0, deg, 0.0)) for at, deg in steps))
    result = judged(records, scenario, metric="overshoot_percent", axis="pitch", from_s=1.0, to_s=2.0, at_most=90.0)
    assert result.value == pytest.approx(100.0 * 3.5 / 4.0)


@pytest.mark.parametrize("metric", Metric)
def test_every_metric_is_measured(metric):
    banded = {"within_deg": 20.0} if metric in (Metric.SETTLING, Metric.RECOVERY) else {}
    axis = {"axis": "pitch"} if metric is Metric.OVERSHOOT else {}
    records, scenario = flight(), replace(SCENARIO, event=(replace(STEP, at_s=0.0),))
    turn(records, 1, -10.0)
    value = judged(records, scenario, metric=metric.value, **banded, **axis).value
    assert value == pytest.approx(math.sin(math.radians(10.0)) if metric is Metric.RHO else 0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"metric": "peak_deg"}, "give at_most, at_least or both"),
        ({"metric": "peak", "at_most": 1.0}, "'peak_deg'"),
        ({"metric": "peak_deg", "at_most": 1.0, "at_least": 2.0}, "at_least must not be above at_most"),
        ({"metric": "peak_deg", "at_most": float("nan")}, "at_most: must be a finite number"),
        ({"metric": "peak_deg", "at_most": 1.0, "from_s": 2.0, "to_s": 2.0}, "to_s must be later than from_s"),
        ({"metric": "peak_deg", "at_most": 1.0, "axis": "x"}, "'roll', 'pitch' or 'yaw'"),
        ({"metric": "peak_deg", "at_most": 1.0, "within_deg": 1.0}, "within_deg"),
        ({"metric": "settling_s", "at_most": 1.0}, "within_deg"),
        ({"metric": "drift_m", "at_most": 1.0, "axis": "roll"}, "drift_m has no axis"),
        ({"metric": "overshoot_percent", "at_most": 1.0}, "needs an axis"),
        ({"metric": "peak_deg", "at_most": 1.0, "to_s": 5.0}, "require.0: to_s must not be later than the end, 4.0 s"),
        ({"metric": "peak_deg", "at_most": 1.0, "from_s": 3.996}, "at least two samples"),
        ({"metric": "overshoot_percent", "axis": "yaw", "at_most": 1.0}, "no step of the reference in yaw"),
        ({"metric": "peak_deg", "at_most": 1.0, "limit": 1.0}, "limit: unknown key"),
    ],
)
def test_a_table_that_cannot_be_judged_is_refused(table, words):
    with pytest.raises(ConfigError) as refused:
        validate(Scenario, {"name": "x", "description": "x", "duration_s": 4.0, "require": [table]}, "x.toml")
    assert words in str(refused.value)


@pytest.mark.parametrize(
    ("table", "reads"),
    [
        ({"metric": "rho_share"}, False),
        ({"metric": "rho_share", "to_s": 0.04}, False),
        ({"metric": "rho_share", "from_s": 0.02}, True),
        ({"metric": "peak_deg", "from_s": 0.02}, False),
    ],
)
def test_share_of_the_envelope_is_read_where_a_window_begins_later(table, reads):
    required = Requirement(**table, at_most=1.0)
    assert reads_share(replace(SCENARIO, require=(required,))) is reads
