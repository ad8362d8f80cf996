"""An autopilot's own view of its errors, against numbers worked out by hand."""

import math

import numpy as np
import pytest

from firmware_model.recording.estimates import ESTIMATE
from firmware_model.recording.journal import RECORD
from gustproof.flight.scoring.estimator_view import compare_estimates, steady_rmse_deg


def turned(axis: int, degrees: list[float]) -> np.ndarray:
    q_NB = np.zeros((len(degrees), 4))
    q_NB[:, 0], q_NB[:, 1 + axis] = np.cos(np.radians(degrees) / 2.0), np.sin(np.radians(degrees) / 2.0)
    return q_NB


def flown(axis: int, degrees: list[float]) -> np.ndarray:
    records = np.zeros(len(degrees), dtype=RECORD)
    records["time_us"], records["q_NB"] = 4000.0 * np.arange(len(degrees)), turned(axis, degrees)
    return records


def told(axis: int, times_us: list[float], degrees: list[float], wanted: list[float]) -> np.ndarray:
    estimates = np.zeros(len(degrees), dtype=ESTIMATE)
    estimates["time_us"], estimates["q_NB"] = times_us, turned(axis, degrees)
    estimates["setpoint_q_NB"], estimates["told_wind_N"] = turned(axis, wanted), np.nan
    return estimates


@pytest.mark.parametrize("axis", range(3))
def test_errors_are_of_the_samples_at_or_after_each_report(axis: int) -> None:
    records = flown(axis, [0.0, 4.0, 8.0, 12.0])
    view = compare_estimates(records, told(axis, [4000.0, 4001.0], [5.0, 11.0], [2.0, 2.0]))
    assert view is not None
    found = view.estimate_rmse_deg, view.control_rmse_deg, view.true_control_rmse_deg
    squares = 1.0 + 9.0, 9.0 + 81.0, 4.0 + 36.0  # estimate less true, estimate less wanted, true less wanted
    assert found == pytest.approx([math.sqrt(each / 6.0) for each in squares])
    assert view.estimate_steady_deg == pytest.approx(math.sqrt(2.0 / 6.0))
    assert view.true_control_steady_deg == pytest.approx(math.sqrt(8.0 / 6.0))
    assert view.estimate_axes_deg == pytest.approx([math.sqrt(5.0) * (each == axis) for each in range(3)], abs=1e-12)


def test_reports_after_the_flight_or_without_a_set_point_do_not_count_and_one_is_too_few() -> None:
    records = flown(0, [0.0, 0.0])
    three = told(0, [0.0, 4000.0, 4001.0], [1.0, 1.0, 50.0], [0.0, 0.0, 0.0])
    view = compare_estimates(records, three)
    assert view is not None
    assert view.control_rmse_deg == pytest.approx(math.sqrt(1.0 / 3.0))
    three["setpoint_q_NB"][1] = np.nan
    assert compare_estimates(records, three) is None
    assert compare_estimates(records[:0], three) is None


def test_headings_on_both_sides_of_the_south_are_near() -> None:
    view = compare_estimates(flown(2, [179.0, 179.0]), told(2, [0.0, 4000.0], [-179.0, -179.0], [-179.0, -179.0]))
    assert view is not None
    assert view.estimate_rmse_deg == pytest.approx(2.0 / math.sqrt(3.0))


def test_wind_is_judged_by_the_level_air_at_the_vehicle_while_it_is_told() -> None:
    records = flown(2, [90.0, 90.0, 90.0])
    records["wind_N"], records["gust_B"] = (4.0, 0.0, 9.0), [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)]
    three = told(2, [0.0, 4000.0, 8000.0], [90.0] * 3, [90.0] * 3)
    view = compare_estimates(records, three)
    assert view is not None
    assert view.wind is None
    three["told_wind_N"][1:] = 4.0, 2.0, 0.0  # the gusts blow east and west: it is 1 and 3 m/s off
    view = compare_estimates(records, three)
    assert view is not None
    assert view.wind is not None
    assert view.wind.told_mps == (4.0, 2.0)
    assert view.wind.true_mps == pytest.approx((4.0, 0.0), abs=1e-12)
    found = view.wind.rmse_mps, view.wind.mean_error_mps, view.wind.air_rms_mps
    assert found == pytest.approx((math.sqrt(5.0), 2.0, 1.0))


def test_steady_error_is_about_the_reference_from_its_sample_on() -> None:
    records = flown(1, [1.0, 3.0, 1.0, 3.0])
    assert steady_rmse_deg(records) == pytest.approx(math.sqrt(1.0 / 3.0))
    asked = [(8000, (0.0, math.radians(-4.0), 0.0))]  # errors 1, 3, 5, 7
    assert steady_rmse_deg(records, asked) == pytest.approx(math.sqrt(5.0 / 3.0))
