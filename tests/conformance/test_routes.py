"""Direct, loopback and UDP are compared with no tolerance."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.events import (
    ActuatorEffect,
    ActuatorLag,
    AttitudeReference,
    GyroBias,
    GyroNoise,
    Payload,
    RotorFailure,
)
from firmware_model.config.scenario import AccelerometerFault, load_scenario
from firmware_model.config.vehicle import Battery, load_vehicle
from firmware_model.config.waveforms import Constant, GustReplay, GustStep, Shear, VonKarman
from firmware_model.numerics.rotations import euler_angles
from gustproof.design.derive import derive
from gustproof.design.designs import load_design
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.loopback import fly_loopback
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.flight.routes.processes import fly
from gustproof.law.form import Schedule, load_law
from gustproof.law.resample import resample

TWO_SECONDS = replace(load_scenario("paper"), duration_s=2.0)
FREE = replace(
    TWO_SECONDS,
    translation="free",
    wind=(*TWO_SECONDS.wind, Constant(kind="constant", velocity_mps=(3.0, -2.0, 0.0))),
)
VON_KARMAN = (VonKarman(kind="von_karman", wind_speed_20ft_mps=12.0),)
EVENTS = (
    AttitudeReference(kind="attitude", at_s=0.3, euler_deg=(6.0, -4.0, 10.0)),
    AttitudeReference(kind="attitude", at_s=1.1, euler_deg=(0.0, 3.0, 0.0)),
    GyroBias(kind="gyro_bias", at_s=0.2, bias_rad_s=(0.01, 0.0, -0.01), over_s=0.5),
    GyroNoise(kind="gyro_noise", at_s=0.4, factor=2.0),
    ActuatorEffect(kind="actuator_effect", at_s=0.6, share=(0.7, 1.0, 0.9)),
    ActuatorLag(kind="actuator_lag", at_s=0.8, lag_s=0.04),
    Payload(kind="payload", at_s=1.0, mass_kg=0.1, inertia_kgm2=(0.001, 0.0, 0.0)),
)
WINDS = (
    GustStep(kind="step", speed_mps=3.0, from_deg=30.0, start_s=0.4),
    GustReplay(kind="replay", rows=((0.0, 1.0, 0.0, 0.5), (1.0, -1.0, 2.0, 0.0))),
    Shear(kind="shear", wind_speed_20ft_mps=4.0, from_deg=200.0),
)


@pytest.mark.parametrize("translation", ["held", "free"])
@pytest.mark.parametrize(("law", "air"), [("flagship", VON_KARMAN), ("hinf-rates", TWO_SECONDS.wind)])
def test_events_and_winds_are_the_same_to_the_bit_on_every_route(law, air, translation, tmp_path):
    scenario = replace(
        TWO_SECONDS, event=EVENTS, wind=(*air, *WINDS), translation=translation,
        initial_attitude_deg=(4.0, -3.0, 60.0), gust_scale=1.3,
    )  # fmt: skip
    flown, airframe = load_law(law), load_vehicle("paper")
    direct = fly_direct(scenario, flown, vehicle=airframe, seed=7)
    assert direct.tobytes() != fly_direct(replace(scenario, event=()), flown, vehicle=airframe, seed=7).tobytes()
    assert fly_loopback(scenario, flown, vehicle=airframe, seed=7).tobytes() == direct.tobytes()
    assert fly(scenario, flown, vehicle=airframe, seed=7, out=tmp_path).records.tobytes() == direct.tobytes()


def test_a_position_loop_around_a_law_is_the_same_to_the_bit_on_every_route(tmp_path):
    turn = AttitudeReference(kind="attitude", at_s=0.8, euler_deg=(0.0, 0.0, 25.0))
    scenario = replace(
        FREE, translation="position_hold", event=(turn, *EVENTS[2:]), initial_attitude_deg=(4.0, -3.0, 60.0)
    )
    law, airframe = load_law("flagship"), load_vehicle("paper")
    direct = fly_direct(scenario, law, vehicle=airframe, seed=7)
    assert (
        direct.tobytes() != fly_direct(replace(scenario, translation="free"), law, vehicle=airframe, seed=7).tobytes()
    )
    assert fly_loopback(scenario, law, vehicle=airframe, seed=7).tobytes() == direct.tobytes()
    assert fly(scenario, law, vehicle=airframe, seed=7, out=tmp_path).records.tobytes() == direct.tobytes()


@pytest.mark.parametrize(("rate", "step_us"), [(300, 3333), (2000, 500)])
def test_a_rate_beside_the_clock_of_stamps_is_the_same_to_the_bit_on_every_route(rate, step_us, tmp_path):
    scenario = replace(TWO_SECONDS, duration_s=1.2, control_rate_hz=rate, physics_rate_hz=4 * rate, event=EVENTS)
    law, airframe = resample(load_law("flagship"), rate), load_vehicle("paper")
    direct = fly_direct(scenario, law, vehicle=airframe, seed=7)
    assert set(np.diff(direct["time_us"])) == {step_us}
    assert len(direct) == round(1.2e6 / step_us)
    assert fly_loopback(scenario, law, vehicle=airframe, seed=7).tobytes() == direct.tobytes()
    assert fly(scenario, law, vehicle=airframe, seed=7, out=tmp_path).records.tobytes() == direct.tobytes()


@pytest.mark.parametrize("scenario", [TWO_SECONDS, FREE], ids=["held", "free"])
def test_a_law_that_feels_force_is_the_same_to_the_bit_on_every_route(scenario, tmp_path):
    law, airframe = load_law("aided"), load_vehicle("paper")
    direct = fly_direct(scenario, law, vehicle=airframe, seed=7)
    faultless = replace(scenario, accelerometer=AccelerometerFault(noise=False))
    assert direct["q_NB"].tobytes() != fly_direct(faultless, law, vehicle=airframe, seed=7)["q_NB"].tobytes()
    assert fly_loopback(scenario, law, vehicle=airframe, seed=7).tobytes() == direct.tobytes()
    assert fly(scenario, law, vehicle=airframe, seed=7, out=tmp_path).records.tobytes() == direct.tobytes()


def test_a_scheduled_law_is_the_same_to_the_bit_on_every_route(tmp_path):
    rng, airframe = np.random.default_rng(5), load_vehicle("paper")
    shapes = {"J": (3, 9), "K": (3, 6), "L": (3, 3), "P": (3, 3), "Q": (9, 3)}
    parts = {name: 0.02 * rng.normal(size=shape) for name, shape in shapes.items()}
    turn = Schedule(parameters=("phi", "theta", "r"), limits=np.array([0.3, 0.2, 0.5]), **parts)
    law = replace(load_law("hinf-scheduled"), schedule=turn)
    scenario = replace(FREE, duration_s=1.0, gust_scale=3.0)
    direct = fly_direct(scenario, law, vehicle=airframe, seed=7)
    assert direct.tobytes() != fly_direct(scenario, replace(law, schedule=None), vehicle=airframe, seed=7).tobytes()
    assert fly_loopback(scenario, law, vehicle=airframe, seed=7).tobytes() == direct.tobytes()
    assert fly(scenario, law, vehicle=airframe, seed=7, out=tmp_path).records.tobytes() == direct.tobytes()


def test_a_rotor_of_eight_that_fails_is_the_same_to_the_bit_on_every_route(tmp_path):
    law, airframe = load_law("flagship"), load_vehicle("octo")
    failure = RotorFailure(kind="rotor_failure", at_s=1.0, rotor=6, share=0.2)
    scenario = replace(FREE, event=(failure,))
    direct = fly_direct(scenario, law, vehicle=airframe, seed=7)
    assert direct["rotors"].shape == (500, 8)
    assert direct["rotors"][-1, 5] < 0.5 * direct["rotors"][-1, 4]
    assert fly_loopback(scenario, law, vehicle=airframe, seed=7).tobytes() == direct.tobytes()
    assert fly(scenario, law, vehicle=airframe, seed=7, out=tmp_path).records.tobytes() == direct.tobytes()


@pytest.mark.parametrize(("law", "vehicle"), [("flagship", "paper"), ("hinf-rates", "paper"), ("flagship", "octo")])
def test_a_battery_that_empties_is_the_same_to_the_bit_on_every_route(law, vehicle, tmp_path):
    small = Battery(cells=3, capacity_ah=0.004, resistance_ohm=0.05, hover_current_a=12.0)  # for 1.2 s or more
    flown, endless = load_law(law), load_vehicle(vehicle)
    airframe = replace(endless, battery=small)
    direct = fly_direct(FREE, flown, vehicle=airframe, seed=7)
    assert np.max(direct["rotors"][-1]) < 0.1
    assert direct.tobytes() != fly_direct(FREE, flown, vehicle=endless, seed=7).tobytes()
    assert fly_loopback(FREE, flown, vehicle=airframe, seed=7).tobytes() == direct.tobytes()
    assert fly(FREE, flown, vehicle=airframe, seed=7, out=tmp_path).records.tobytes() == direct.tobytes()


@pytest.mark.parametrize("law", ["pid-fair", "hinf-reference"])
def test_a_law_turns_to_the_reference_of_the_scenario(law):
    turn = AttitudeReference(kind="attitude", at_s=0.5, euler_deg=(4.0, -2.5, 6.0))
    scenario = replace(load_scenario("calm"), duration_s=8.0, event=(turn,))
    records = fly_direct(scenario, load_law(law), vehicle=load_vehicle("paper"))
    angles = np.degrees(euler_angles(records["q_NB"]))
    assert np.max(np.abs(angles[:125])) < 0.1
    # A linear law integrates rates as angles, which is an error of second order: 4 deg times 6 deg.
    np.testing.assert_allclose(angles[-1], turn.euler_deg, atol=0.5)


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
    assert flight.outcome is FlightOutcome.DONE
    assert_undisturbed(flight.counters)
    assert flight.records.tobytes() == fly_direct(scenario, flown, vehicle=airframe, seed=7).tobytes()
    assert flight.realtime_factor > 0.0
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_at_1_khz_two_processes_equal_direct_to_the_bit(tmp_path):
    scenario, airframe = replace(TWO_SECONDS, control_rate_hz=1000), load_vehicle("paper")
    law, _ = derive(replace(load_design("D1"), dt=scenario.dt))
    flight = fly(scenario, law, vehicle=airframe, seed=7, out=tmp_path)
    assert (flight.outcome, flight.timing) == (FlightOutcome.DONE, None)
    assert_undisturbed(flight.counters)
    assert flight.records.tobytes() == fly_direct(scenario, law, vehicle=airframe, seed=7).tobytes()


def assert_undisturbed(counters: dict[str, int]) -> None:
    """Nothing is counted, except that a busy machine may hold a process up until a sample or two is sent again."""
    resent = counters.get("resent", 0)
    assert resent <= 5
    assert counters.get("duplicate", 0) <= resent
    assert counters.keys() <= {"resent", "duplicate"}


def test_another_seed_is_another_flight():
    flown, airframe = load_law("hinf-d1"), load_vehicle("paper")
    first, second = (fly_loopback(TWO_SECONDS, flown, vehicle=airframe, seed=seed) for seed in (1, 2))
    assert first.tobytes() != second.tobytes()
