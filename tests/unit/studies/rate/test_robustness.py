"""Robustness to inertia and lag: proved ranges, members beyond them, and the figures of the shipped laws."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.airframe.hover import is_stable_at_hover
from gustproof.law.form import load_law
from gustproof.robust.uncertain.uncertainty import Spreads
from gustproof.studies.rate import robustness
from gustproof.studies.rate.axis_loop import axis_loop
from gustproof.studies.rate.law_margins import SPREADS, axis_robustness, hover_margins
from gustproof.studies.rate.robustness import robust_peak, robust_stability, robustness_over_frequency


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle("paper")


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("paper-turbulence")


def member(vehicle, shares, lag_share):
    inertia = tuple(share * value for share, value in zip(shares, vehicle.inertia_B, strict=True))
    return replace(vehicle, inertia_B=inertia, actuator_lag=lag_share * vehicle.actuator_lag)


@pytest.mark.parametrize(
    ("name", "certified", "unstable"), [("flagship", 1.9, 1.99), ("pid-fair", 2.8, 2.97), ("hinf-scheduled", 2.1, 2.24)]
)
def test_shipped_laws_are_certified_nearly_up_to_an_unstable_member(name, certified, unstable, vehicle, scenario):
    law = load_law(name)
    axes = axis_robustness(law, vehicle, scenario)
    assert len(axes) == 3
    assert certified <= min(axis.certified for axis in axes)
    assert min(axis.unstable.times for axis in axes) <= unstable  # an independent review's figure, rounded
    text = (Path(__file__).parents[4] / "src/gustproof/guide/laws.md").read_text(encoding="utf-8")
    row = next(line for line in text.splitlines() if line.startswith(f"| `{name}` |"))
    floor = [math.floor(1000.0 * spread * min(axis.certified for axis in axes)) / 10.0 for spread in (0.2, 0.3)]
    assert f"certified stable with inertia ±{floor[0]:g} % and lag ±{floor[1]:g} % off" in row
    for k, axis in enumerate(axes):
        found = axis.unstable
        assert 0.995 * found.times < axis.certified < found.times
        assert max(abs(found.inertia) / 0.2, abs(found.actuator_lag) / 0.3) == pytest.approx(found.times, rel=1e-9)
        shares = np.ones(3)
        shares[k] += found.inertia
        assert is_stable_at_hover(law, member(vehicle, shares, 1.0 + found.actuator_lag), scenario) is False
    # any inertias and lag in the box that holds for all three axes
    rng, factor = np.random.default_rng(1), min(axis.certified for axis in axes)
    for corner in range(60):
        delta = rng.choice((-1.0, 1.0), 4) if corner < 20 else rng.uniform(-1.0, 1.0, 4)
        shares, lag_share = 1.0 + 0.2 * factor * delta[:3], 1.0 + 0.3 * factor * delta[3]
        assert is_stable_at_hover(law, member(vehicle, shares, lag_share), scenario)


@pytest.mark.parametrize(("name", "axis", "corner"), [("flagship", 2, -1.0), ("pid-fair", 1, 1.0)])
def test_no_more_is_certified_when_the_search_finds_too_little(name, axis, corner, vehicle, scenario, monkeypatch):
    # the flagship breaks up where inertia and lag are least, pid-fair in pitch where both are largest
    law = load_law(name)
    nearest = robust_stability(law, vehicle, scenario, SPREADS, axis).unstable
    assert np.sign([nearest.inertia, nearest.actuator_lag]).tolist() == [corner, corner]
    far = replace(nearest, times=1.1 * nearest.times)
    monkeypatch.setattr(robustness, "_first_instability", lambda *_: far)
    found = robust_stability(law, vehicle, scenario, SPREADS, axis)
    assert 0.85 * nearest.times < found.certified < nearest.times


def test_the_search_goes_on_to_the_nearest_of_two_instabilities(vehicle, scenario, monkeypatch):
    # one grid at the end of the range, where the most unstable member lies in a direction that is stable for longer
    fine = robust_stability(load_law("hinf-scheduled"), vehicle, scenario, SPREADS, 0).unstable
    monkeypatch.setattr(robustness, "_FACTORS", 1)
    coarse = robust_stability(load_law("hinf-scheduled"), vehicle, scenario, SPREADS, 0).unstable
    assert coarse.times == pytest.approx(fine.times, rel=1e-3)


def test_a_law_without_an_unstable_member_is_certified_to_the_end(vehicle, scenario):
    found = robust_stability(load_law("hinf-d2"), vehicle, scenario, SPREADS, 2)
    assert found.unstable is None
    assert 0.3 * found.certified == pytest.approx(0.99)


def test_one_spread_alone_gives_the_gain_margin(vehicle, scenario):
    # 1 / inertia is a gain: the least inertia that is stable is the gain margin's
    law = load_law("pid-fair")
    found = robust_stability(law, vehicle, scenario, Spreads(inertia=0.5), 0)
    least = 1.0 + found.unstable.inertia
    assert found.unstable.actuator_lag == 0.0
    assert is_stable_at_hover(law, member(vehicle, (least * 1.001, 1.0, 1.0), 1.0), scenario)
    assert not is_stable_at_hover(law, member(vehicle, (least, 1.0, 1.0), 1.0), scenario)
    assert found.certified == pytest.approx(found.unstable.times, rel=2e-3)
    with pytest.raises(ValueError, match="nothing uncertain"):
        robust_stability(law, vehicle, scenario, Spreads(), 0)


def test_the_flagship_peak_over_the_box_is_bracketed(vehicle, scenario):
    peak = robust_peak(load_law("flagship"), vehicle, scenario, SPREADS, 2)
    # the search kept the corners at 2
    assert 1.99 < peak.lower <= peak.upper <= 2.005
    assert peak.delta == {"inertia": 1.0, "actuator_lag": 1.0}
    worst = hover_margins(load_law("flagship"), member(vehicle, (1.0, 1.0, 1.2), 1.3), scenario)
    assert worst.Ms == pytest.approx(peak.lower, rel=1e-4)


def test_no_spread_leaves_the_nominal_peak(vehicle, scenario):
    peaks = [robust_peak(load_law("flagship"), vehicle, scenario, Spreads(), axis) for axis in range(3)]
    nominal = hover_margins(load_law("flagship"), vehicle, scenario).Ms
    assert max(peak.lower for peak in peaks) == pytest.approx(nominal, rel=1e-4)
    assert all(peak.lower <= peak.upper <= 1.002 * peak.lower for peak in peaks)


@pytest.mark.parametrize("name", ["hinf-d1", "hinf-rates", "aided"])
def test_a_law_without_a_loop_of_one_axis_is_refused(name, vehicle, scenario):
    law = load_law(name)
    coupled = replace(law, D=law.D + 1e-6)
    with pytest.raises(ValueError, match="couples its axes, uses the accelerometer or commands no torque"):
        robust_stability(coupled, vehicle, scenario, SPREADS, 0)


def test_a_law_that_feels_force_is_refused_as_its_gyro_is_not_all_that_closes_the_loop(vehicle, scenario):
    law = load_law("flagship")
    wider = ((0, 0), (0, 2))
    feeling = replace(law, B=np.pad(law.B, wider), D=np.pad(law.D, wider), rate_limit=None)
    with pytest.raises(ValueError, match="uses the accelerometer"):
        robust_stability(feeling, vehicle, scenario, SPREADS, 0)


def test_an_unstable_nominal_loop_has_no_range(vehicle, scenario):
    law = load_law("hinf-d2")
    backwards = replace(law, C=-law.C, D=-law.D)
    with pytest.raises(ValueError, match="nominal loop is unstable"):
        robust_stability(backwards, vehicle, scenario, SPREADS, 0)
    assert axis_robustness(backwards, vehicle, scenario) == ()


def test_bounds_over_frequency_hold_for_every_member_and_meet_the_peaks(vehicle, scenario):
    law, rng = load_law("flagship"), np.random.default_rng(1)
    found = robustness_over_frequency(law, vehicle, scenario, SPREADS, 0)
    assert np.all(found.mu_found <= found.mu_proved)
    assert np.all(found.S_found <= found.S_proved)
    assert np.all(np.isfinite(found.S_proved[found.omega[1:] > 2.0]))
    unstable = robust_stability(law, vehicle, scenario, SPREADS, 0).unstable
    assert np.max(found.mu_proved) > 1.0 / unstable.times > 0.9 * np.max(found.mu_proved)
    assert np.max(found.mu_found) == pytest.approx(1.0 / unstable.times, rel=0.1)
    loop = axis_loop(law, vehicle, scenario, 0)
    inertia, lag = (
        value * (1.0 + spread * rng.uniform(-1.0, 1.0, 200))
        for value, spread in ((loop.inertia, SPREADS.inertia), (loop.actuator_lag, SPREADS.actuator_lag))
    )
    omega = found.omega[:-1] * (found.omega[1:] / found.omega[:-1]) ** rng.uniform(size=len(found.S_proved))
    assert np.all(np.abs(loop.sensitivity(omega, inertia, lag)) <= found.S_proved)


def test_a_member_with_a_pole_on_a_band_is_outside_what_is_proved_there(vehicle, scenario):
    """At the edge of stability a pole crosses the circle: the band of its angle is proved to less than that member."""
    law = load_law("flagship")
    unstable = robust_stability(law, vehicle, scenario, SPREADS, 0).unstable
    found = robustness_over_frequency(law, vehicle, scenario, SPREADS, 0)
    band = int(np.argmax(found.mu_found))
    loop = axis_loop(law, vehicle, scenario, 0)
    critical = np.geomspace(found.omega[band], found.omega[band + 1], 400)
    edge = (
        loop.inertia * (1.0 + np.array([unstable.inertia])),
        loop.actuator_lag * (1.0 + np.array([unstable.actuator_lag])),
    )
    assert np.max(np.abs(loop.sensitivity(critical, *edge))) > 1e2
    assert found.mu_proved[band] >= 1.0 / unstable.times
