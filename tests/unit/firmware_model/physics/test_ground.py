"""The ground: what rests stays, what slides stops, what lands stays down."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.scenario import AccelerometerFault, GyroFault, Scenario
from firmware_model.config.vehicle import GRAVITY, load_vehicle
from firmware_model.config.waveforms import Constant, Dryden
from firmware_model.numerics.rotations import from_euler, rotate
from firmware_model.recording.journal import RECORD
from firmware_model.sim.layout import X_BODY
from firmware_model.sim.vehicle_loop import VehicleLoop
from firmware_model.types import MotorsOff, PositionTarget, Setpoint, TorqueCommand

VEHICLES = {name: load_vehicle(name) for name in ("paper", "iris")}
CALM = Scenario(
    name="calm",
    description="",
    duration_s=60.0,
    translation="free",
    altitude_m=2.0,
    gyro=GyroFault(noise=False),
    accelerometer=AccelerometerFault(noise=False),
)
WINDY = replace(
    CALM,
    wind=(
        Constant(kind="constant", velocity_mps=(6.0, -3.0, 0.0)),
        Dryden(kind="dryden", wind_speed_20ft_mps=15.4),
    ),
)


def fly(loop: VehicleLoop, setpoint: Setpoint, seconds: float) -> np.ndarray:
    records = [loop.advance(setpoint, 0).copy() for _ in range(round(250 * seconds))]
    loop.observe()
    return np.array(records).view(RECORD)[:, 0]


def dropped(vehicle, height: float, *, attitude=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0)) -> VehicleLoop:
    """A vehicle without thrust whose feet, were it level, are at `height` [m]."""
    loop = VehicleLoop(vehicle, CALM, 1)
    state = loop._sim.state
    state[X_BODY : X_BODY + 6] = (0.0, 0.0, -vehicle.gear.height - height, *velocity)
    state[X_BODY + 6 : X_BODY + 10] = from_euler(*attitude)
    state[X_BODY + 16] = 0.0
    return loop


@pytest.mark.parametrize("scenario", [CALM, WINDY], ids=["calm", "windy"])
@pytest.mark.parametrize("name", VEHICLES)
def test_what_stands_with_its_motors_off_does_not_move_at_all(name, scenario):
    loop = VehicleLoop(VEHICLES[name], scenario, 1, interactive=True)
    records = fly(loop, MotorsOff(), 10.0)
    for field in ("position_N", "q_NB"):
        assert np.ptp(records[field], axis=0).max() == 0.0
    assert not records["velocity_N"].any()
    assert not records["omega_B"].any()
    np.testing.assert_array_equal(records["specific_force_B"], [(0.0, 0.0, np.float32(-GRAVITY))] * len(records))
    assert loop.on_ground
    assert loop.rotors == (0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("name", VEHICLES)
def test_it_lands_at_half_a_metre_a_second_without_a_bounce(name):
    vehicle = VEHICLES[name]
    loop = VehicleLoop(vehicle, CALM, 1)
    records = fly(loop, PositionTarget((0.0, 0.0, 0.0), 0.0, 0.5), 10.0)
    height = -records["position_N"][:, 2] - vehicle.gear.height  # of its feet
    touch = int(np.argmax(height < 0.0))
    assert records["velocity_N"][touch - 1, 2] == pytest.approx(0.5, abs=0.02)
    assert (height[touch:] < 0.0).all()  # the feet never leave the ground again
    assert np.abs(np.diff(records["position_N"][-500:], axis=0)).max() == 0.0
    assert loop.on_ground
    still = fly(loop, MotorsOff(), 2.0)
    np.testing.assert_allclose(still["specific_force_B"][-1], (0.0, 0.0, -GRAVITY), atol=1e-6)


@pytest.mark.parametrize("name", VEHICLES)
def test_it_lands_in_wind_and_moderate_gusts_upright_and_stays_there(name):
    loop = VehicleLoop(VEHICLES[name], WINDY, 2)
    fly(loop, PositionTarget((0.0, 0.0, -2.0), 0.0, None), 8.0)
    landing = fly(loop, PositionTarget((0.0, 0.0, 0.0), 0.0, 0.5), 15.0)
    assert loop.on_ground
    assert np.hypot(*landing["position_N"][-1, :2]) < 5.0  # [m] what a gust leaves of the place, and a slide
    fly(loop, MotorsOff(), 2.0)  # the rotors run out
    rest = fly(loop, MotorsOff(), 5.0)
    assert np.ptp(rest["position_N"], axis=0).max() == 0.0
    assert rotate(loop.q_NB, (0.0, 0.0, 1.0))[2] > 0.999


def test_a_sliding_vehicle_is_stopped_by_its_friction():
    vehicle = VEHICLES["paper"]
    loop = dropped(vehicle, -vehicle.gear.sag, velocity=(1.0, 0.0, 0.0))
    records = fly(loop, MotorsOff(), 2.0)
    # Coulomb: v^2 / (2 mu g), a little more as the last 5 cm/s are viscous, and less air.
    assert records["position_N"][-1, 0] == pytest.approx(1.0 / (2.0 * vehicle.gear.friction * GRAVITY), rel=0.1)
    assert not records["velocity_N"][-1].any()


@pytest.mark.parametrize("name", VEHICLES)
def test_a_vehicle_that_falls_askew_comes_to_rest_on_its_feet(name):
    loop = dropped(VEHICLES[name], 0.3, attitude=(0.3, -0.2, 1.0))
    records = fly(loop, MotorsOff(), 5.0)
    assert not records["velocity_N"][-1].any()
    assert rotate(loop.q_NB, (0.0, 0.0, 1.0))[2] == pytest.approx(1.0, abs=1e-3)
    assert loop.on_ground


def test_a_vehicle_on_its_back_lies_on_its_rotors():
    vehicle = VEHICLES["paper"]
    loop = dropped(vehicle, 0.0, attitude=(np.pi, 0.0, 0.0))
    records = fly(loop, MotorsOff(), 5.0)
    assert -records["position_N"][-1, 2] == pytest.approx(vehicle.rotors.height - vehicle.gear.sag, abs=1e-3)
    np.testing.assert_allclose(records["velocity_N"][-1], 0.0, atol=1e-6)


def test_more_side_wind_than_friction_holds_makes_it_slide_downwind():
    # Thrust of .45 of the weight leaves .55 on the feet; the gale pushes harder than friction holds that.
    vehicle = VEHICLES["iris"]
    gale = replace(CALM, wind=(Constant(kind="constant", velocity_mps=(0.0, 14.0, 0.0)),))
    lifted = TorqueCommand(0, (0.0, 0.0, 0.0), 0.45 * vehicle.mass * GRAVITY / (4.0 * vehicle.rotors.thrust_max))
    held = fly(VehicleLoop(vehicle, gale, 1, interactive=True), MotorsOff(), 1.0)
    assert not held["velocity_N"].any()
    slides = fly(VehicleLoop(vehicle, gale, 1, interactive=True), lifted, 1.0)
    assert slides["velocity_N"][-1, 1] > 0.1


@pytest.mark.parametrize("name", VEHICLES)
def test_thrust_that_grows_lifts_it_off_gently(name):
    vehicle = VEHICLES[name]
    loop = VehicleLoop(vehicle, CALM, 1, interactive=True)
    hover = vehicle.mass * GRAVITY / (4.0 * vehicle.rotors.thrust_max)
    fastest = 0.0
    for k in range(1000):
        records = loop.advance(TorqueCommand(0, (0.0, 0.0, 0.0), 0.999 * hover * k / 1000), 0).view(RECORD)
        fastest = max(fastest, float(np.abs(records["velocity_N"]).max()))
    assert fastest < 0.06  # [m/s]: the springs let go of half their yield, slower than (g sag)^(1/2) / e / 2 = .04
