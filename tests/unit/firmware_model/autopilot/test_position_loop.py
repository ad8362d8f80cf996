"""The on-board loops of height and position."""

import math
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.autopilot.position_loop import attitude_for_acceleration
from firmware_model.config.scenario import GyroFault, Scenario
from firmware_model.config.vehicle import GRAVITY, load_vehicle
from firmware_model.config.waveforms import Constant, Dryden
from firmware_model.numerics.rotations import euler_angles, from_euler, rotate
from firmware_model.recording.journal import RECORD
from firmware_model.sim.vehicle_loop import VehicleLoop
from firmware_model.types import AttitudeTarget, LevelFlight, PositionTarget, Setpoint, TorqueCommand

VEHICLES = {name: load_vehicle(name) for name in ("paper", "iris")}
CALM = Scenario(name="calm", description="", duration_s=60.0, translation="free", gyro=GyroFault(noise=False))
MODERATE = Dryden(kind="dryden", wind_speed_20ft_mps=15.4)
HERE = PositionTarget((0.0, 0.0, -10.0), 0.0, None)
by_vehicle = pytest.mark.parametrize("vehicle", VEHICLES.values(), ids=VEHICLES.keys())


def fly(loop: VehicleLoop, setpoint: Setpoint, seconds: float) -> np.ndarray:
    return np.array([loop.advance(setpoint, 0).copy() for _ in range(round(250 * seconds))]).view(RECORD)[:, 0]


@pytest.mark.slow
@by_vehicle
def test_it_holds_its_place_in_moderate_gusts_within_a_few_metres(vehicle):
    for seed in (1, 2, 3):
        error = fly(VehicleLoop(vehicle, replace(CALM, wind=(MODERATE,)), seed), HERE, 60.0)["position_N"]
        assert np.hypot(error[:, 0], error[:, 1]).max() < 3.5  # [m] 3.1 at worst over 20 seeds
        assert math.sqrt(np.mean(error[:, 0] ** 2 + error[:, 1] ** 2)) < 1.2
        assert np.abs(error[:, 2] + 10.0).max() < 0.5


@by_vehicle
def test_its_integral_takes_out_a_steady_wind(vehicle):
    steady = replace(CALM, wind=(Constant(kind="constant", velocity_mps=(6.0, -4.0, 0.5)),))
    end = fly(VehicleLoop(vehicle, steady, 1), HERE, 60.0)["position_N"][-1]
    np.testing.assert_allclose(end, HERE.position_N, atol=0.02)


@by_vehicle
def test_it_goes_to_a_place_and_turns_on_the_way(vehicle):
    loop = VehicleLoop(vehicle, CALM, 1)
    records = fly(loop, PositionTarget((8.0, -6.0, -12.0), 2.0, None), 25.0)
    np.testing.assert_allclose(records["position_N"][-1], (8.0, -6.0, -12.0), atol=0.05)
    assert euler_angles(records["q_NB"])[-1, 2] == pytest.approx(2.0, abs=0.01)
    along = records["position_N"][:, :2] @ (0.8, -0.6)
    assert along.max() < 10.2  # no overshoot to speak of
    assert np.degrees(np.arccos(1.0 - 2.0 * np.sum(records["q_NB"][:, 1:3] ** 2, axis=1))).max() < 38.0


@by_vehicle
def test_it_flies_no_faster_than_its_limits(vehicle):
    loop, limits = VehicleLoop(vehicle, CALM, 1), vehicle.position
    out = fly(loop, PositionTarget((200.0, 0.0, -60.0), 0.0, None), 15.0)["velocity_N"]
    assert np.hypot(out[:, 0], out[:, 1]).max() == pytest.approx(limits.xy_velocity_max, rel=0.1)
    assert -out[:, 2].min() == pytest.approx(limits.z_velocity_max_up, rel=0.1)
    down = fly(loop, PositionTarget((0.0, 0.0, -20.0), 0.0, None), 6.0)["velocity_N"]
    assert down[:, 2].max() == pytest.approx(limits.z_velocity_max_down, rel=0.1)


@by_vehicle
def test_a_steady_descent_is_one(vehicle):
    records = fly(VehicleLoop(vehicle, CALM, 1), HERE._replace(v_down=0.5), 10.0)
    np.testing.assert_allclose(records["velocity_N"][1000:, 2], 0.5, atol=0.01)


@by_vehicle
@pytest.mark.parametrize("kind", ["torque", "rates", "attitude", "level"])
def test_without_a_thrust_the_height_is_held_where_that_began(vehicle, kind):
    setpoint: Setpoint = {
        "torque": TorqueCommand(0, (0.0, 0.0, 0.0), None),
        "rates": AttitudeTarget(0, None, (0.0, 0.0, 0.3), None),
        "attitude": AttitudeTarget(0, from_euler(0.3, 0.0, 0.0), None, None),
        "level": LevelFlight(),
    }[kind]
    loop = VehicleLoop(vehicle, CALM, 1)
    climb = TorqueCommand(0, (0.0, 0.0, 0.0), 0.6)
    began = fly(loop, climb, 1.0)["position_N"][-1, 2]
    down = fly(loop, setpoint, 8.0)["position_N"][:, 2]
    assert began < -10.1
    assert down.min() > began - 1.5  # it has speed to lose
    assert down[-1] == pytest.approx(began, abs=0.1)
    begun_anew = fly(loop, climb, 1.0)["position_N"][-1, 2]
    assert fly(loop, setpoint, 8.0)["position_N"][-1, 2] == pytest.approx(begun_anew, abs=0.1)


def test_thrust_that_is_given_is_flown():
    vehicle = VEHICLES["paper"]
    records = fly(VehicleLoop(vehicle, CALM, 1), TorqueCommand(0, (0.0, 0.0, 0.0), 0.75), 1.0)
    np.testing.assert_allclose(records["thrust_z_command"][1:, 0], -3.0 * vehicle.rotors.thrust_max)
    end = records["thrust_z"][-1, 0]
    assert end == pytest.approx(-3.0 * vehicle.rotors.thrust_max, rel=1e-6)  # 20 time constants


@by_vehicle
def test_level_keeps_the_heading_that_it_began_with(vehicle):
    loop = VehicleLoop(vehicle, replace(CALM, wind=(MODERATE,)), 1)
    fly(loop, HERE._replace(yaw=-1.2), 10.0)
    yaw = euler_angles(fly(loop, LevelFlight(), 20.0)["q_NB"])[:, 2]
    np.testing.assert_allclose(yaw, -1.2, atol=0.06)
    tilt = euler_angles(fly(loop, LevelFlight(), 5.0)["q_NB"])[:, :2]
    assert np.abs(tilt).max() < 0.1


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5])
@pytest.mark.parametrize("acceleration", [(0.0, 0.0), (3.0, 0.0), (0.0, -4.0), (-2.0, 5.0)])
def test_it_leans_so_that_the_thrust_points_where_it_is_to_accelerate(yaw, acceleration):
    q_NB = attitude_for_acceleration((*acceleration, 0.0), yaw)
    north, east, down = rotate(q_NB, (0.0, 0.0, -1.0))
    assert (north / -down, east / -down) == pytest.approx(tuple(a / GRAVITY for a in acceleration), abs=1e-9)
    assert euler_angles(np.array([q_NB]))[0, 2] == pytest.approx(yaw, abs=1e-9)


def test_gains_that_are_changed_in_flight_act_from_then_on():
    vehicle = VEHICLES["iris"]
    loop = VehicleLoop(vehicle, CALM, 1)
    loop.set_position_loop(replace(vehicle.position, z_velocity_max_up=1.0))
    records = fly(loop, PositionTarget((0.0, 0.0, -30.0), 0.0, None), 5.0)
    assert -records["velocity_N"][:, 2].min() == pytest.approx(1.0, rel=0.1)
    loop.set_stabilizer(replace(vehicle.stabilizer, rate_limit=0.1))
    turning = fly(loop, PositionTarget((0.0, 0.0, -30.0), 3.0, None), 5.0)
    assert np.abs(turning["omega_B"][:, 2]).max() < 0.15
