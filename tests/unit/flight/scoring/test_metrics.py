"""Metrics against flights whose figures are known by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.recording.journal import RECORD
from gustproof.flight.scoring import metrics
from gustproof.flight.scoring.metrics import (
    Metrics,
    angle_share,
    attitude,
    command_limit,
    measure,
    median_metrics,
    peak_rate,
)
from gustproof.law.form import load_law

VEHICLE, SCENARIO = load_vehicle("paper"), load_scenario("paper")
ROUNDING = 1e-12  # relative: a few operations in double precision


def flight(n: int = 1000):
    records = np.zeros(n, dtype=RECORD)
    records["time_us"] = np.arange(n) * 4000
    records["q_NB"][:, 0] = 1.0
    return records


def turned(axis: int, angle) -> np.ndarray:
    q = np.zeros((np.size(angle), 4))
    q[:, 0], q[:, 1 + axis] = np.cos(np.asarray(angle) / 2), np.sin(np.asarray(angle) / 2)
    return q


def figures(records) -> Metrics:
    return measure(records, VEHICLE, SCENARIO, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize(("axis", "name"), [(0, "roll"), (1, "pitch"), (2, "yaw")])
def test_a_constant_tilt_is_the_peak_and_rmse_of_its_axis_alone(axis, name):
    records = flight()
    records["q_NB"] = turned(axis, math.radians(-30.0))
    result = figures(records)
    others = {"roll", "pitch", "yaw"} - {name}
    assert getattr(result, f"peak_{name}_deg") == pytest.approx(30.0, rel=ROUNDING)
    assert getattr(result, f"rmse_{name}_deg") == pytest.approx(30.0, rel=ROUNDING)
    assert all(getattr(result, f"peak_{other}_deg") < 1e-12 for other in others)
    assert result.peak_deg == pytest.approx(30.0, rel=ROUNDING)
    assert result.rmse_deg == pytest.approx(30.0 / math.sqrt(3.0), rel=ROUNDING)


def test_settled_peak_leaves_out_the_first_two_seconds() -> None:
    records = flight()
    records["q_NB"][499] = turned(0, math.radians(30.0))[0]
    records["q_NB"][500] = turned(1, math.radians(-4.0))[0]
    records["q_NB"][700] = turned(2, math.radians(3.0))[0]
    assert figures(records).peak_deg == pytest.approx(30.0, rel=ROUNDING)
    assert figures(records).peak_settled_deg == pytest.approx(4.0, rel=ROUNDING)
    assert figures(records[:500]).peak_settled_deg == figures(records).peak_deg  # nothing was flown after 2 s


@pytest.mark.parametrize("turns", [1.0, -1.0, 2.5, -2.5, 200.0, -200.0])
@pytest.mark.parametrize(("axis", "name"), [(0, "roll"), (2, "yaw")])
def test_a_full_turn_of_roll_or_yaw_counts_as_360_degrees(axis, name, turns):
    records = flight(500)  # up to .4 turns a sample
    records["q_NB"] = turned(axis, np.linspace(0.0, 2.0 * math.pi * turns, 500))
    assert attitude(records)[-1, axis] == pytest.approx(2.0 * math.pi * turns, rel=1e-9)
    result = figures(records)
    assert getattr(result, f"peak_{name}_deg") == result.peak_deg == pytest.approx(360.0 * abs(turns), rel=1e-9)
    # The mean of k^2 for k = 0 to n is n (2 n + 1) / 6.
    rms = 360.0 * abs(turns) * math.sqrt((2 * 499 + 1) / (6 * 499))
    assert getattr(result, f"rmse_{name}_deg") == pytest.approx(rms, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_torque_figures_are_those_of_a_sine(axis):
    records = flight()
    t = records["time_us"] * 1e-6
    rate = 2.5 * math.pi  # five whole periods, and a sample on the crest
    records["torque_command_B"][:, axis] = 3.0 * np.sin(rate * t)
    result = figures(records)
    assert result.torque_peak_nm == pytest.approx(3.0, rel=1e-12)
    assert result.torque_rms_nm == pytest.approx(3.0 / math.sqrt(6.0), rel=1e-3)
    # The difference quotient of a sine over dt has its derivative's amplitude times sinc(rate dt / 2).
    quotient = 3.0 * rate * np.sinc(rate * SCENARIO.dt / 2.0 / math.pi)
    assert result.torque_slew_rms == pytest.approx(quotient / math.sqrt(6.0), rel=1e-3)


def test_time_at_the_limit_is_counted_once_for_all_axes():
    records = flight()
    limit = VEHICLE.torque_limit
    records["torque_command_B"][10:20, 0] = limit[0]
    records["torque_command_B"][15:25, 1] = -limit[1]
    assert figures(records).saturated_s == pytest.approx(15 * SCENARIO.dt, rel=ROUNDING)


@pytest.mark.parametrize("rate", [1.4999, -1.5001])
def test_rho_is_in_bounds_up_to_the_rate_of_table_ii(rate):
    records = flight()
    records["omega_B"][500, 1] = rate
    assert figures(records).rho_in_bounds == (abs(rate) <= 1.5)
    assert peak_rate(records) == abs(rate)


@pytest.mark.parametrize("end_deg", [89.0, -89.0, 91.0, -91.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_turning_past_90_degrees_leaves_the_bounds(axis, end_deg):
    records = flight()
    records["q_NB"] = turned(axis, np.linspace(0.0, math.radians(end_deg), len(records)))
    # Beyond 90 degrees of pitch the Euler angles tell a roll of 180.
    assert figures(records).rho_in_bounds is (abs(end_deg) < 90.0)


def test_no_share_of_an_angle_is_over_the_angle():
    angles = (0.0, *np.geomspace(1e-300, math.pi, 5000).tolist())
    assert all(angle_share(angle) <= angle and angle_share(-angle) <= angle for angle in angles)


def test_figures_of_a_flight_in_blocks_are_those_of_the_whole(monkeypatch):
    records = flight()
    records["q_NB"] = turned(2, np.linspace(0.0, 30.0, 1000))
    records["torque_command_B"][:, 0] = np.sin(0.1 * np.arange(1000.0))
    whole = figures(records)
    monkeypatch.setattr(metrics, "record_blocks", lambda each: np.array_split(each, 3))
    assert figures(records) == whole


def test_one_record_is_refused():
    with pytest.raises(ValueError, match="1 records"):
        figures(flight(1))


def test_medians_are_taken_figure_by_figure_and_bounds_must_hold_in_every_flight():
    flights = []
    for angle, torque, rate in ((0.1, 3.0, 0.0), (0.2, 1.0, 0.0), (0.3, 2.0, 9.0)):
        records = flight()
        records["q_NB"] = turned(0, angle)
        records["torque_command_B"] = torque
        records["omega_B"][3] = rate
        flights.append(figures(records))
    result = median_metrics(flights)
    assert result.peak_roll_deg == flights[1].peak_roll_deg
    assert result.torque_peak_nm == flights[2].torque_peak_nm
    assert not result.rho_in_bounds


def test_a_law_is_saturated_at_its_own_limits_where_these_are_smaller() -> None:
    law, records = load_law("flagship"), flight()
    small = replace(law, limits=0.1 * law.limits)
    for limit, first in zip(small.limits, (0, 10, 20), strict=True):
        records["torque_command_B"][first : first + 10, first // 10] = -np.float32(limit)  # as a message carries it
    assert measure(records, VEHICLE, SCENARIO).saturated_s == 0.0
    assert measure(records, VEHICLE, SCENARIO, law=small).saturated_s == pytest.approx(30 * SCENARIO.dt)
    for unlimited in (None, law, replace(law, limits=3.0 * law.limits), load_law("hinf-rates")):
        assert command_limit(VEHICLE, unlimited).tolist() == [*VEHICLE.torque_limit]
