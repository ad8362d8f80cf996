"""What is possible and where laws stand: in figures, in a picture, in the report."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.airframe.predict import predict
from gustproof.law.form import load_law
from gustproof.show.report.figures import save_trade_off
from gustproof.studies.rate import placement
from gustproof.studies.rate.law_margins import hover_margins

LAWS = {name: load_law(name) for name in ("pid-fair", "indi", "hinf-rates")}


@pytest.fixture(scope="module")
def standing():
    vehicle, scenario = load_vehicle("paper"), load_scenario("paper-turbulence")
    margins = {name: hover_margins(law, vehicle, scenario) for name, law in LAWS.items()}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(placement, "SLEWS", (10.0, 20.0))
        patch.setattr(placement, "PEAKS", (0.9, 1.36, 2.0))
        limits, places = placement.performance_limits(LAWS, margins, vehicle, scenario)
        return SimpleNamespace(limits=limits, places=places)


@pytest.mark.slow
def test_laws_stand_above_the_least_at_their_price_and_that_above_the_limit(standing):
    assert standing.places["hinf-rates"] is None
    for name in ("pid-fair", "indi"):
        place = standing.places[name]
        assert place.Ms == pytest.approx(1.36, abs=0.005)
        assert place.slew == pytest.approx(19.9, rel=1e-3)
        assert place.rmse_deg > place.least_rmse_deg > standing.limits.gyro_deg
        foretold = predict(LAWS[name], load_vehicle("paper"), load_scenario("paper-turbulence"))
        assert (place.own_rate, place.own_rate_rmse_deg) == (foretold.own_rate, math.degrees(foretold.own_rate_rmse))
    # Both pay the same price: the least error there is the same.
    pid, indi = standing.places["pid-fair"], standing.places["indi"]
    assert pid.least_rmse_deg == pytest.approx(indi.least_rmse_deg, rel=2e-3)
    assert pid.rmse_deg > indi.rmse_deg


def test_limits_stand_in_order(standing):
    found = standing.limits
    assert found.clairvoyant_any_slew_deg < found.clairvoyant_deg < found.gyro_any_slew_deg < found.gyro_deg
    less, more = found.curves
    assert (less.slew, more.slew) == (10.0, 20.0)
    # No law has a sensitivity peak of 0.9: its point is left out.
    assert less.Ms == pytest.approx((1.36, 2.0), rel=1e-3)
    assert np.all(np.array(less.rmse_deg) > np.array(more.rmse_deg))
    assert min(more.rmse_deg) > more.any_Ms_deg == found.gyro_deg


def test_the_trade_off_figure_has_limits_and_laws_where_they_are(drawn, standing, tmp_path):
    flown = dict.fromkeys(LAWS, SimpleNamespace(rmse_deg=0.12))
    save_trade_off(standing.limits, standing.places, flown, tmp_path / "trade-off.png")
    (figure,) = drawn
    for axes in figure.axes:
        lines = {line.get_label(): line for line in axes.get_lines()}
        curve = lines["least of linear laws, slew 20 N m/s"]
        assert tuple(curve.get_ydata()) == standing.limits.curves[1].rmse_deg
        assert set(lines["least of all gyro-only laws, slew 20 N m/s"].get_ydata()) == {standing.limits.gyro_deg}
        flown = lines["indi, slew 19.9 N m/s"]
        assert (flown.get_xdata()[0], flown.get_ydata()[0]) == (standing.places["indi"].Ms, 0.12)
        rings = [line for line in axes.get_lines() if line.get_fillstyle() == "none"]
        assert [line.get_ydata()[0] for line in rings] == [standing.places[n].rmse_deg for n in ("pid-fair", "indi")]
    assert not [text.get_text() for text in figure.legends[0].get_texts() if "hinf-rates" in text.get_text()]


def test_without_turbulence_or_torque_there_is_no_place():
    vehicle, law = load_vehicle("paper"), LAWS["pid-fair"]
    assert placement.locate(law, 1.36, vehicle, load_scenario("calm")) is None
    assert placement.locate(LAWS["hinf-rates"], 1.36, vehicle, load_scenario("paper-turbulence")) is None


def test_a_vehicle_that_no_law_holds_at_the_stated_slew_has_no_place():
    heavy = replace(load_vehicle("paper"), gust_gain=50.0)
    assert placement.locate(LAWS["pid-fair"], 1.36, heavy, load_scenario("paper-turbulence")) is None
