"""Laws of free flight: falling, hovering, drifting, turning; and where it must agree with the test stand."""

import math
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.scenario import AccelerometerFault, GyroFault, Scenario
from firmware_model.config.vehicle import GRAVITY, load_vehicle
from firmware_model.config.waveforms import Constant, Dryden, GustCosine
from firmware_model.numerics.rotations import euler_angles, from_euler
from firmware_model.numerics.soa import flatten
from firmware_model.physics.aerodynamics import (
    Air,
    AirParams,
    FreeInputs,
    FreeParams,
    air_params,
    begin_sample,
    motion_rate,
    sensor_wrench,
    surround,
)
from firmware_model.physics.aerodynamics import (
    fly as fly_sample,
)
from firmware_model.physics.ground import ground_params
from firmware_model.physics.rigid_body import Body, Wrench, body_params, turn_from_outside
from firmware_model.recording.journal import RECORD
from firmware_model.sim.vehicle_loop import VehicleLoop
from firmware_model.types import AttitudeTarget, LevelFlight, Setpoint, TorqueCommand

VEHICLES = {name: load_vehicle(name) for name in ("paper", "iris")}
CALM = Scenario(
    name="calm",
    description="",
    duration_s=60.0,
    translation="free",
    altitude_m=500.0,
    gyro=GyroFault(noise=False),
    accelerometer=AccelerometerFault(noise=False),
)
ZERO = (0.0, 0.0, 0.0)
NOTHING = Wrench(ZERO, 0.0)
STILL, AIR_DENSITY = Air(ZERO, ZERO), 1.225
HIGH = Body((0.0, 0.0, -500.0), ZERO, (1.0, 0.0, 0.0, 0.0), ZERO, ZERO, 0.0)
by_vehicle = pytest.mark.parametrize("vehicle", VEHICLES.values(), ids=VEHICLES.keys())


def fly(vehicle, scenario: Scenario, setpoint: Setpoint, seconds: float) -> np.ndarray:
    loop = VehicleLoop(vehicle, scenario, 1)
    records = [loop.advance(setpoint, 0).copy() for _ in range(round(250 * seconds))]
    return np.array(records).view(RECORD)[:, 0]


def constants(vehicle, dt: float = 0.001) -> FreeParams:
    return FreeParams(body_params(vehicle, dt), air_params(vehicle), ground_params(vehicle))


def inputs(params: FreeParams, *, command=NOTHING, air=STILL, moment_B=ZERO, gust_omega_B=ZERO) -> FreeInputs:
    turn_B = turn_from_outside(params.body, moment_B, gust_omega_B)
    return FreeInputs(command, surround(params.body, params.air, air.gust_B[2], turn_B), air, True)


def wind(*velocity: float) -> Scenario:
    return replace(CALM, wind=(Constant(kind="constant", velocity_mps=velocity),))


def torque(*torque_B: float, throttle: float | None = None) -> TorqueCommand:
    return TorqueCommand(time_us=0, torque_B=torque_B, throttle=throttle)


@by_vehicle
def test_without_thrust_it_falls_with_g_and_feels_nothing(vehicle):
    params, body = constants(vehicle), HIGH
    assert sensor_wrench(params, body, inputs(params))[0] == (0.0, 0.0, 0.0)
    for _ in range(25):
        body = fly_sample(params, body, inputs(params), 0.001, 4)
    # Drag at 1 m/s is 1/2 rho A v^2; over .1 s it takes less than that from the speed.
    lost = 0.5 * AIR_DENSITY * vehicle.drag_area / vehicle.mass * 0.1
    assert GRAVITY * 0.1 - lost < body.velocity_N[2] < GRAVITY * 0.1


@by_vehicle
def test_in_vacuum_it_falls_and_thrust_equal_to_weight_holds_it_which_the_accelerometer_feels(vehicle):
    params = constants(vehicle, 0.01)._replace(air=AirParams(1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    weight, rest = vehicle.mass * GRAVITY, HIGH._replace(position_N=ZERO)
    falls, hovers = rest._replace(velocity_N=(3.0, 0.0, 0.0)), rest._replace(thrust=weight)
    nothing, lift = (inputs(params, command=Wrench(ZERO, F))._replace(near_ground=False) for F in (0.0, weight))
    assert sensor_wrench(params, hovers, lift)[0] == pytest.approx((0.0, 0.0, -GRAVITY), rel=1e-15)
    for _ in range(200):
        falls, hovers = fly_sample(params, falls, nothing, 0.01, 1), fly_sample(params, hovers, lift, 0.01, 1)
    fallen = (falls.position_N[0], falls.position_N[2], falls.velocity_N[2])
    assert fallen == pytest.approx((6.0, 0.5 * GRAVITY * 4.0, GRAVITY * 2.0), rel=1e-12)
    assert (hovers.position_N[2], hovers.velocity_N[2]) == pytest.approx((0.0, 0.0), abs=1e-12)


@by_vehicle
def test_in_vacuum_it_falls_as_galileo_found_while_it_turns(vehicle):
    params = constants(vehicle)._replace(air=AirParams(1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    body = HIGH._replace(velocity_N=(3.0, 0.0, 0.0), omega_B=(1.0, -2.0, 0.5))
    for _ in range(250):
        body = fly_sample(params, body, inputs(params, air=Air(ZERO, (5.0, -4.0, 1.0))), 0.001, 4)
    fallen = (3.0, 0.0, -500.0 + 0.5 * GRAVITY)
    assert body.position_N == pytest.approx(fallen, abs=1e-9)
    assert body.velocity_N == pytest.approx((3.0, 0.0, GRAVITY), abs=1e-10)


@by_vehicle
def test_the_error_of_all_states_falls_with_the_fourth_power_of_the_step(vehicle):
    start = HIGH._replace(omega_B=(2.0, -1.0, 3.0), thrust=vehicle.mass * GRAVITY, velocity_N=(4.0, 1.0, -2.0))
    command = Wrench((0.02, -0.01, 0.01), 1.2 * vehicle.mass * GRAVITY)
    ends = []
    for steps in (5, 10, 20, 160):
        dt, body = 0.2 / steps, start
        params = constants(vehicle, dt)
        for _ in range(steps):  # a sample of one step: the path, too, is found anew for each
            body = fly_sample(params, body, inputs(params, command=command, air=Air((1.0, 2.0, 0.5), ZERO)), dt, 1)
        ends.append(np.array([*flatten(body)]))
    coarse, middle, fine = (np.abs(end - ends[3])[:13] for end in ends[:3])
    np.testing.assert_allclose(np.log2(np.linalg.norm(coarse[:3]) / np.linalg.norm(middle[:3])), 4.0, atol=0.5)
    np.testing.assert_allclose(np.log2(np.linalg.norm(middle[3:]) / np.linalg.norm(fine[3:])), 4.0, atol=0.5)


@by_vehicle
def test_moments_from_outside_add_to_those_of_the_air_with_their_signs(vehicle):
    params, hovering = constants(vehicle), HIGH._replace(thrust=vehicle.mass * GRAVITY)
    given = inputs(params, moment_B=(0.5, -0.25, 0.125), gust_omega_B=(1.0, 2.0, 3.0))
    blown = inputs(params, moment_B=(0.5, -0.25, 0.125), gust_omega_B=(1.0, 2.0, 3.0), air=Air((1.0, 2.0, 4.0), ZERO))
    rates = []
    for each in (given, blown):
        motion, acting, _ = begin_sample(params, hovering, each, 0.004)
        rates.append(motion_rate(params, motion, (each, acting)))
    alone = np.array((0.5, -0.25, 0.125)) / vehicle.inertia_B + np.array(vehicle.rate_damping_B) * (1.0, 2.0, 3.0)
    assert rates[0].omega_B == pytest.approx(alone)
    gain = vehicle.gust_gain
    added = (2.0 * gain, -gain, 4.0 * vehicle.gust_yaw_ratio * gain)
    assert sensor_wrench(params, hovering, blown)[1] == pytest.approx(added)
    assert rates[1].omega_B == pytest.approx(alone + np.array(added) / vehicle.inertia_B)
    square = 0.5 * AIR_DENSITY * vehicle.drag_area * math.sqrt(21.0)
    plane, axis = vehicle.rotor_drag + square, vehicle.heave_drag + square
    force = np.array((plane, 2.0 * plane, 4.0 * axis - vehicle.mass * GRAVITY))
    np.testing.assert_allclose(sensor_wrench(params, hovering, blown)[0], force / vehicle.mass)


@pytest.mark.slow
@by_vehicle
def test_it_falls_no_faster_than_its_drag_lets_it(vehicle):
    params = constants(vehicle, 0.01)
    speed = math.sqrt(vehicle.mass * GRAVITY / (0.5 * AIR_DENSITY * vehicle.drag_area))
    body = HIGH._replace(position_N=(0.0, 0.0, -1e6))
    for _ in range(3000):
        body = fly_sample(params, body, inputs(params), 0.01, 1)
    assert body.velocity_N[2] == pytest.approx(speed, rel=1e-6)


@by_vehicle
def test_hover_is_trim(vehicle):
    records = fly(vehicle, CALM, torque(0.0, 0.0, 0.0, throttle=None), 5.0)
    np.testing.assert_allclose(records["position_N"], [(0.0, 0.0, -500.0)] * len(records), atol=1e-9)
    np.testing.assert_allclose(records["rotors"], vehicle.mass * GRAVITY / 4.0, rtol=1e-9)
    np.testing.assert_allclose(records["specific_force_B"], [(0.0, 0.0, -GRAVITY)] * len(records), atol=1e-6)


@pytest.mark.slow
@by_vehicle
@pytest.mark.parametrize("velocity", [(5.0, 0.0, 0.0), (-3.0, 4.0, 0.0)])
def test_level_it_drifts_with_the_wind_toward_where_that_blows(vehicle, velocity):
    records = fly(vehicle, wind(*velocity), LevelFlight(), 100.0)
    np.testing.assert_allclose(records["velocity_N"][-1], velocity, atol=1e-3)
    travelled = records["position_N"][-1, :2]
    assert np.dot(travelled, velocity[:2]) == pytest.approx(np.linalg.norm(travelled) * 5.0, rel=1e-3)
    np.testing.assert_allclose(records["wind_N"], [velocity] * len(records))


@by_vehicle
def test_tilted_its_speed_through_the_air_is_where_drag_meets_thrust(vehicle):
    pitch = -0.2
    target = AttitudeTarget(time_us=0, q_NB=from_euler(0.0, pitch, 0.0), omega_B=None, thrust=None)
    v_north, v_east, v_down = fly(vehicle, CALM, target, 60.0)["velocity_N"][-1]
    assert (v_east, v_down) == pytest.approx((0.0, 0.0), abs=1e-3)
    # Along x of B and along z the air passes with v cos and v sin; thrust T carries what weight and drag leave.
    ahead, above = -v_north * math.cos(pitch), -v_north * math.sin(pitch)
    square = 0.5 * AIR_DENSITY * vehicle.drag_area * v_north
    weight = vehicle.mass * GRAVITY

    def unbalanced(thrust: float) -> tuple[float, float]:
        spin = math.sqrt(thrust / weight)
        F_x = (spin * vehicle.rotor_drag + square) * ahead
        F_z = (spin * vehicle.heave_drag + square) * above - thrust
        north = F_x * math.cos(pitch) + F_z * math.sin(pitch)
        return north, -F_x * math.sin(pitch) + F_z * math.cos(pitch) + weight

    thrust = weight
    for _ in range(50):
        thrust += unbalanced(thrust)[1] / math.cos(pitch)
    assert v_north > 2.0
    assert unbalanced(thrust)[0] == pytest.approx(0.0, abs=2e-3 * weight)


@by_vehicle
def test_balanced_rotors_do_not_turn_it(vehicle):
    records = fly(vehicle, CALM, torque(0.0, 0.0, 0.0, throttle=0.7), 2.0)
    assert np.ptp(records["rotors"], axis=1).max() < 1e-9
    assert np.abs(records["omega_B"]).max() < 1e-12  # rounding
    assert records["velocity_N"][-1, 2] < -3.0


@by_vehicle
def test_rotors_that_turn_left_turn_it_right_by_their_drag(vehicle):
    records = fly(vehicle, CALM, torque(0.0, 0.0, 0.1), 1.0)
    spin, drag = np.array(vehicle.rotors.spin), vehicle.rotors.drag_ratio
    np.testing.assert_allclose(records["rotors"] @ spin * drag, records["torque_B"][:, 2], atol=1e-12)
    assert records["omega_B"][-1, 2] > 0.1


@by_vehicle
def test_a_gust_pushes_it_the_way_it_blows_and_turns_it_as_on_the_stand(vehicle):
    gust = GustCosine(kind="one_minus_cosine", amplitude_mps=(0.0, 4.0, 0.0), start_s=0.0, length_s=1.0)
    free = fly(vehicle, replace(CALM, wind=(gust,)), torque(0.0, 0.0, 0.0), 1.0)
    held = fly(vehicle, replace(CALM, wind=(gust,), translation="held"), torque(0.0, 0.0, 0.0), 1.0)
    assert free["velocity_N"][-1, 1] > 0.1
    # At first the vehicle has no speed of its own: the same air gives the same moment.
    np.testing.assert_allclose(free["moment_B"][:50], held["moment_B"][:50], rtol=0.05, atol=1e-6)
    assert free["specific_force_B"][125, 1] > 0.5 * vehicle.rotor_drag * 4.0 / vehicle.mass


@by_vehicle
def test_free_and_held_turn_alike_in_still_air(vehicle):
    """A level turn moves nothing; tilted, the own speed v gives the moment gust_gain v, which the law takes out.

    For that moment the rate loop leaves (gust_gain v) / (I rate_p angle_p) at most, before its integral acts.
    """
    for angles, bound_by_speed in (((0.0, 0.0, 0.7), False), ((0.15, -0.1, 0.3), True)):
        target = AttitudeTarget(time_us=0, q_NB=from_euler(*angles), omega_B=None, thrust=None)
        held, free = (fly(vehicle, replace(CALM, translation=kind), target, 2.0) for kind in ("held", "free"))
        apart = np.abs(euler_angles(held["q_NB"]) - euler_angles(free["q_NB"])).max()
        speed = np.linalg.norm(free["velocity_N"], axis=1).max()
        stiffness = min(vehicle.inertia_B) * min(vehicle.stabilizer.rate_p) * vehicle.stabilizer.angle_p
        allowed = vehicle.gust_gain * speed / stiffness if bound_by_speed else 0.0
        assert apart <= 1e-5 + allowed  # 1e-5: the strapdown's own error, which only the free one's is pulled from


def test_gusts_go_with_their_scale_and_the_mean_wind_stays():
    scenario = replace(
        CALM,
        altitude_m=100.0,  # the low-altitude model of turbulence ends at 304.8 m
        wind=(
            Constant(kind="constant", velocity_mps=(1.0, 2.0, 3.0)),
            Dryden(kind="dryden", wind_speed_20ft_mps=15.0),
        ),
    )
    for translation in ("held", "free"):
        plain, halved = (VehicleLoop(VEHICLES["iris"], replace(scenario, translation=translation), 1) for _ in "ab")
        halved.set_gust_scale(0.5)
        for loop in (plain, halved):
            loop.observe()
        for field in ("gust_B", "gust_omega_B"):
            np.testing.assert_array_equal(np.array(halved.true_vector(field)), 0.5 * np.array(plain.true_vector(field)))
        assert halved.true_vector("wind_N") == plain.true_vector("wind_N") == (1.0, 2.0, 3.0)


def test_the_estimate_follows_the_truth_though_the_gyro_drifts():
    scenario = replace(CALM, gyro=GyroFault(noise=False, bias_rad_s=(0.01, 0.0, 0.0)))
    loop = VehicleLoop(VEHICLES["paper"], scenario, 1)
    for _ in range(5000):
        loop.advance(LevelFlight(), 0)
    loop.observe()
    apart = euler_angles(np.array([loop.estimate_q_NB]))[0] - euler_angles(np.array([loop.q_NB]))[0]
    assert apart[0] == pytest.approx(0.03, rel=0.05)  # bias times the time constant of 3 s
    assert abs(apart[1:]).max() < 1e-3


def test_feet_need_fine_steps():
    with pytest.raises(ValueError, match="physics_rate_hz must be at least 500"):
        replace(CALM, physics_rate_hz=250)
