"""Examples of a user's controller: flown from their files, linear near level, the same bits in each flight."""

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from gustproof.flight.controllers.stepper import make_stepper
from gustproof.flight.controllers.user_controller import parse_controller
from gustproof.flight.routes.controllers import fly_controller
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.guide.examples import geometric, geometric_lead, mpc, rotor_indi

DT, LEVEL = 0.004, (0.0, 0.0, 0.0)
AIR = replace(load_scenario("paper-turbulence"), duration_s=0.6)
MAKERS = {
    "geometric.py:make": geometric.make,
    "geometric_lead.py:make": geometric_lead.make,
    "rotor_indi.py:make": rotor_indi.make,
    "mpc.py:make": mpc.make,
}


@pytest.fixture(params=MAKERS)
def source(request) -> str:
    if request.param.startswith("mpc"):
        pytest.importorskip("osqp", reason="OSQP is not installed")
    return request.param


@pytest.mark.parametrize("delay_samples", [1, 2])
def test_an_example_holds_the_vehicle_from_its_file(source, delay_samples):
    entry = parse_controller(str(files("gustproof.guide") / "examples" / source))
    flight = fly_controller(replace(AIR, delay_samples=delay_samples), entry, vehicle=load_vehicle("paper"))
    assert flight.outcome is FlightOutcome.DONE
    assert abs(flight.records["omega_B"]).max() < 0.2  # [rad/s]


@pytest.mark.parametrize("vehicle", ["paper", "octo", "iris"])
def test_near_level_an_example_is_linear_and_answers_motion_with_opposite_torque(source, vehicle):
    vehicle = load_vehicle(vehicle)
    rates = np.random.default_rng(3).normal(size=(40, 3))

    def answer(size):
        flying = MAKERS[source](vehicle)
        return np.array([flying.step(size * rate, LEVEL, LEVEL, DT) for rate in rates]) / size

    small = answer(1e-6)
    assert small == pytest.approx(answer(-2e-6), rel=1e-4, abs=1e-4 * np.abs(small).max())
    assert np.all(small[0] * rates[0] < 0.0)


def test_a_flight_repeats_to_the_bit(source):
    vehicle = load_vehicle("octo")
    samples = np.random.default_rng(4).normal(size=(80, 3)).tolist()
    wanted = [LEVEL] * 40 + [(1.0, -0.5, 0.3)] * 40

    def fly(flying):
        return [flying.step(gyro, euler, (0.0, 0.0, -9.8), DT) for gyro, euler in zip(samples, wanted, strict=True)]

    first, second = MAKERS[source](vehicle), MAKERS[source](vehicle)
    once = fly(first)
    first.reset()
    assert once == fly(first) == fly(second)
    assert np.all(np.abs(once) <= np.array(vehicle.torque_limit))


def test_a_large_error_commands_the_rate_limit_at_most(source):
    vehicle = load_vehicle("paper")
    flying, euler = MAKERS[source](vehicle), (1.5, 0.0, 0.0)
    # at rest far from the reference: torque towards it. At 1.5 times the rate limit towards it: against the motion
    assert flying.step(LEVEL, euler, LEVEL, DT)[0] > 0.0
    flying.reset()
    rate = 1.5 * vehicle.stabilizer.rate_limit
    torques = [flying.step((rate, 0.0, 0.0), euler, LEVEL, DT)[0] for _ in range(50)]
    assert 50 * DT * rate < euler[0]
    assert np.mean(torques) < 0.0


def test_a_vehicle_without_gains_is_refused_in_one_line(source):
    entry = parse_controller(str(files("gustproof.guide") / "examples" / source))
    with pytest.raises(ConfigError, match="has gains for paper, iris, octo, none for 'mine'"):
        make_stepper(entry, replace(load_vehicle("iris"), name="mine"))
