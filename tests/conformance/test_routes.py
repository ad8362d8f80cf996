"""Direct, loopback and UDP are compared with no tolerance."""

from dataclasses import replace

import pytest

from firmware_model.scenario import load_scenario
from firmware_model.vehicle import load_vehicle
from firmware_model.wind import Constant
from gustproof.closed_loop import fly_direct
from gustproof.law import load_law
from gustproof.sitl import Outcome, fly, fly_loopback

TWO_SECONDS = replace(load_scenario("paper"), duration_s=2.0)
FREE = replace(
    TWO_SECONDS,
    translation="free",
    wind=(*TWO_SECONDS.wind, Constant(kind="constant", velocity_mps=(3.0, -2.0, 0.0))),
)


@pytest.mark.parametrize("law", ["hinf-d1", "hinf-scheduled", "hinf-rates"])
@pytest.mark.parametrize("vehicle", ["paper", "iris"])
@pytest.mark.parametrize("delay", [0, 1, 3])
def test_loopback_equals_direct_to_the_bit(law, vehicle, delay):
    scenario = replace(TWO_SECONDS, delay_samples=delay)
    flown, airframe = load_law(law), load_vehicle(vehicle)
    direct = fly_direct(scenario, flown, vehicle=airframe, seed=7)
    assert fly_loopback(scenario, flown, vehicle=airframe, seed=7).tobytes() == direct.tobytes()


@pytest.mark.parametrize("law", ["hinf-scheduled", "hinf-rates"])
@pytest.mark.parametrize("vehicle", ["paper", "iris"])
@pytest.mark.parametrize("delay", [0, 2])
def test_loopback_equals_direct_to_the_bit_in_free_flight(law, vehicle, delay):
    scenario = replace(FREE, delay_samples=delay)
    flown, airframe = load_law(law), load_vehicle(vehicle)
    direct = fly_direct(scenario, flown, vehicle=airframe, seed=7)
    assert fly_loopback(scenario, flown, vehicle=airframe, seed=7).tobytes() == direct.tobytes()
    assert direct["velocity_N"][-1, 0] > 0.1  # it is carried along
    assert abs(direct["position_N"][-1, 2] + FREE.altitude_m) < 0.5


@pytest.mark.parametrize("scenario", [TWO_SECONDS, FREE], ids=["held", "free"])
@pytest.mark.parametrize("law", ["hinf-scheduled", "hinf-rates"])
def test_two_processes_equal_direct_to_the_bit(law, scenario, tmp_path):
    flown, airframe = load_law(law), load_vehicle("paper")
    told: list[float] = []
    flight = fly(scenario, flown, vehicle=airframe, seed=7, out=tmp_path, progress=told.append)
    assert (flight.outcome, flight.counters) == (Outcome.DONE, {})
    assert flight.records.tobytes() == fly_direct(scenario, flown, vehicle=airframe, seed=7).tobytes()
    assert flight.realtime_factor > 0.0
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_another_seed_is_another_flight():
    flown, airframe = load_law("hinf-d1"), load_vehicle("paper")
    first, second = (fly_loopback(TWO_SECONDS, flown, vehicle=airframe, seed=seed) for seed in (1, 2))
    assert first.tobytes() != second.tobytes()
