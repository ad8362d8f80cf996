"""Every shipped scenario is flown, and shows what its first line says; what must hold stands in its file."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from firmware_model.autopilot.modes import Mode
from firmware_model.config.scenario import SCENARIOS, list_scenarios, load_scenario
from firmware_model.config.vehicle import GRAVITY, load_vehicle
from gustproof.design.cascades.autotune import autotune_pid
from gustproof.flight.routes.controllers import fly_here
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.flight import warnings
from gustproof.flight.scoring.metrics import attitude
from gustproof.flight.scoring.requirements import judge
from gustproof.law.form import load_law

VEHICLE = load_vehicle("paper")
OTHERS = {"rotor-failure": load_vehicle("octo")}
"""Vehicles of scenarios that the paper's can't fly."""
LAWS = {"attitude-steps": "pid-fair", "doublets": "flagship", "large-step": "flagship", "rotor-failure": "flagship"}
"""Who flies; `hinf-scheduled` regulates to level and takes no reference."""


@cache
def flown(name: str, law: str | None = None, seed: int = 1):
    """Fly a scenario: without messages, unless its script is about them."""
    scenario, law = load_scenario(name), law or LAWS.get(name, "hinf-scheduled")
    return fly_here(scenario, load_law(law), vehicle=OTHERS.get(name, VEHICLE), seed=seed)


def failures(name: str, law: str | None = None) -> list[str]:
    results = judge(flown(name, law), load_scenario(name), OTHERS.get(name, VEHICLE))
    return [result.requirement.metric.value for result in results if not result.is_met]


def peak_deg(name: str, begin_s: float, end_s: float, law: str | None = None) -> float:
    records = flown(name, law)
    at = records["time_us"] * 1e-6
    return float(np.max(np.abs(np.degrees(attitude(records)[(at >= begin_s) & (at < end_s)]))))


@pytest.mark.parametrize("name", list_scenarios())
def test_it_is_flown_to_its_end_and_keeps_what_it_requires(name):
    records = flown(name)
    assert len(records) == load_scenario(name).samples
    assert all(np.all(np.isfinite(records[field])) for field in ("q_NB", "omega_B", "position_N", "torque_B"))
    assert failures(name) == []


@pytest.mark.parametrize("name", list_scenarios())
def test_its_first_line_says_what_it_shows_and_something_is_required(name):
    first, *_ = (SCENARIOS / f"{name}.toml").read_text(encoding="utf-8").splitlines()
    assert first == f'description = "{load_scenario(name).description}"'
    assert len(load_scenario(name).description) <= 120
    assert load_scenario(name).require or name == "calm"


@pytest.mark.parametrize(
    "name",
    [
        "attitude-steps", "coning", "gust-pitch", "gust-roll", "gust-sweep", "gust-yaw", "kick", "large-step",
        "replayed-wind", "severe-1797", "shear", "weak-actuators",
    ],
)  # fmt: skip
def test_it_tells_a_better_law_from_a_worse_one(name):
    assert failures(name, "hinf-d1") != []


@pytest.mark.parametrize("name", ["kick", "large-step"])
@pytest.mark.parametrize("law", ["flagship", "pid-fair", "indi", "hinf-reference", "hinf-scheduled", "aided"])
def test_large_errors_are_flown_back_by_every_torque_law_but_the_papers_own(name, law):
    if name == "kick" or load_law(law).takes_references:
        assert failures(name, law) == []


@pytest.mark.parametrize(("name", "axis"), [("gust-roll", 0), ("gust-pitch", 1), ("gust-yaw", 2)])
def test_a_gust_for_an_axis_turns_the_vehicle_about_that_axis(name, axis):
    peaks = np.max(np.abs(attitude(flown(name))), axis=0)
    others = [peak for i, peak in enumerate(peaks) if i != axis]
    assert peaks[axis] > 1.5 * max(others)  # the rest is gyro noise


def test_the_sweep_goes_through_its_band():
    u = flown("gust-sweep")["gust_B"][:, 0]
    crossings = np.flatnonzero(np.diff(np.signbit(u))) * load_scenario("gust-sweep").dt
    rates = np.pi / np.diff(crossings)
    # The rate rises linearly by 19.8 rad/s in 60 s: between two crossings it is that of their middle.
    middle = 0.5 * (crossings[1:] + crossings[:-1])
    assert rates == pytest.approx(0.2 + 0.33 * middle, rel=0.05)


def test_a_replayed_wind_is_the_same_air_for_every_law_and_seed():
    first, second = flown("replayed-wind"), flown("replayed-wind", "pid-fair", 2)
    assert first["gust_B"].tobytes() == second["gust_B"].tobytes()
    assert first["gust_B"][100] == pytest.approx([float(x) for x in _rows()[10][1:]], rel=1e-9)  # rounding of a time


def _rows() -> list[list[str]]:
    text = (SCENARIOS / "replayed-wind.csv").read_text(encoding="utf-8")
    return [line.split(",") for line in text.splitlines()[1:]]


def test_the_shear_carries_the_vehicle_east_and_the_law_keeps_level():
    north, east, down = flown("shear")["position_N"][-1]
    assert east > 100.0 > 10.0 > abs(north)
    assert down == pytest.approx(-10.0, abs=0.5)


def test_the_delay_leads_to_swinging_beyond_the_delay_margin_and_not_before():
    assert peak_deg("link-delay", 0.0, 9.0) < 0.2  # up to 8 ms
    assert peak_deg("link-delay", 18.0, 21.0) > 10.0  # 24 ms; the margin at hover is 11 ms beyond the sample
    assert peak_deg("link-delay", 18.0, 21.0, "hinf-d1") < 0.2  # whose margin is 117 ms


def rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def test_the_attitude_goes_where_it_is_asked_to():
    angles = np.degrees(attitude(flown("attitude-steps")))
    for end_s, asked in ((2, (0, 0, 0)), (9, (10, 0, 0)), (16, (0, 10, 0)), (24, (0, 0, 10))):
        assert angles[end_s * 250 - 1] == pytest.approx(asked, abs=0.5)


def test_a_drifting_bias_turns_the_vehicle_by_its_integral():
    angles = np.degrees(attitude(flown("gyro-drift")))
    # A law that holds its own estimate level turns against the bias: .005 * (30 / 2 + 20) rad in all. With the angles
    # come the couplings of Euler's kinematics, of second order: .175^2 rad = 1.8 deg.
    assert angles[-1] == pytest.approx(-np.degrees(0.175) * np.ones(3), abs=1.8)


def test_ten_times_the_noise_reaches_the_actuators_as_such():
    torque = np.diff(flown("noisy-gyro")["torque_command_B"], axis=0)
    assert rms(torque[2500:]) / rms(torque[:2499]) == pytest.approx(10.0, rel=0.1)


def test_weak_actuators_give_half_of_what_is_asked():
    scenario, records = load_scenario("weak-actuators"), flown("weak-actuators")
    a = np.exp(-scenario.dt / VEHICLE.actuator_lag)
    asked = records["torque_command_B"][:-1]
    given = (records["torque_B"][1:] - a * records["torque_B"][:-1]) / (1.0 - a)
    shares = [float(np.sum(given[w] * asked[w]) / np.sum(asked[w] ** 2)) for w in (slice(1250), slice(1250, None))]
    assert shares == pytest.approx([1.0, 0.5], rel=1e-3)


def test_a_dropped_payload_leaves_the_thrust_that_the_rest_weighs():
    thrust = -flown("payload-drop")["thrust_z"][:, 0]
    assert np.mean(thrust[1000:1250]) == pytest.approx(10.0 * GRAVITY, rel=0.05)
    assert np.mean(thrust[-1250:]) == pytest.approx(7.0 * GRAVITY, rel=0.05)


def test_another_controller_takes_the_place_of_the_dead_one():
    modes = flown("controller-crash")["mode"]
    flown_by = [Mode(value) for value in modes[np.flatnonzero(np.diff(modes, prepend=0.0))]]
    assert flown_by == [Mode.OFFBOARD, Mode.STABILIZED, Mode.OFFBOARD]
    lost = int(np.argmax(modes == Mode.STABILIZED.value)) * 0.004
    assert lost == pytest.approx(5.0, abs=0.01)  # a second after the last set-point


def test_the_gust_front_is_held_against_and_would_blow_the_vehicle_away_otherwise():
    scenario = load_scenario("gust-front")
    alone = fly_direct(replace(scenario, event=()), load_law("hinf-scheduled"), vehicle=VEHICLE)
    assert alone["position_N"][-1, 1] > 50.0
    assert np.max(np.abs(flown("gust-front")["position_N"][:, :2])) < 3.0


def test_a_dead_rotor_of_eight_is_flown_on_by_the_others_and_a_dead_one_of_four_is_not():
    hover = 10.0 * GRAVITY / 8.0
    shares = flown("rotor-failure")["rotors"][-1] / hover
    np.testing.assert_allclose(shares, (0.0, 1.0, 1.0, 1.0, 1.5, 0.5, 1.5, 1.5), atol=0.05)  # pseudo-inverse, by hand
    scenario = load_scenario("rotor-failure")
    records = fly_direct(scenario, load_law("flagship"), vehicle=VEHICLE)
    assert np.max(np.abs(np.degrees(attitude(records)[:1250]))) < 2.0
    assert -records["position_N"][-1, 2] < 0.5  # on the ground
    [warning] = warnings(scenario, load_law("flagship"), VEHICLE)
    assert warning == "vehicle 'paper' can't hover after the rotor failure at 5 s"
    assert not any("hover" in line for line in warnings(scenario, load_law("flagship"), OTHERS["rotor-failure"]))


def test_a_payload_drops_from_any_vehicle():
    iris = load_vehicle("iris")
    law = autotune_pid(iris, bandwidth=1.0)
    thrust = -fly_direct(load_scenario("payload-drop"), law, vehicle=iris)["thrust_z"][:, 0]
    assert np.mean(thrust[-1250:]) == pytest.approx(0.7 * iris.mass * GRAVITY, rel=0.05)


def test_there_are_as_many_as_promised():
    assert len(list_scenarios()) >= 16
