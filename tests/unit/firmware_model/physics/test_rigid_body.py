"""Laws of nature that a rigid body obeys whatever its code looks like."""

import math

import numpy as np
import pytest

from firmware_model.config.vehicle import load_vehicle
from firmware_model.numerics.rotations import from_euler, rotate, to_euler
from firmware_model.numerics.soa import flatten
from firmware_model.physics.rigid_body import (
    GRAVITY,
    Body,
    BodyParams,
    Motion,
    Wrench,
    add_motions,
    body_params,
    change_motion,
    held_force,
    make_stages,
    motion_rate,
    scale_motion,
    step_attitude,
    turn_from_outside,
)

VEHICLE = load_vehicle("paper")
I_B = np.array(VEHICLE.inertia_B)
ZERO = (0.0, 0.0, 0.0)
NOTHING = Wrench(ZERO, 0.0)
REST = Body(ZERO, ZERO, (1.0, 0.0, 0.0, 0.0), ZERO, ZERO, 0.0)
STILL = Motion(ZERO, (1.0, 0.0, 0.0, 0.0), ZERO)


def params(dt: float, *, damping: float = 0.0) -> BodyParams:
    return body_params(VEHICLE, dt)._replace(damping_x=damping, damping_y=damping, damping_z=damping)


def step(constants: BodyParams, body: Body, dt: float, *, command=NOTHING, moment_B=ZERO, gust_omega_B=ZERO) -> Body:
    return step_attitude(constants, body, command, turn_from_outside(constants, moment_B, gust_omega_B), dt)


def fly(body: Body, seconds: float, dt: float, *, damping: float = 0.0, **inputs) -> Body:
    constants = params(dt, damping=damping)
    for _ in range(round(seconds / dt)):
        body = step(constants, body, dt, **inputs)
    return body


def omega(body: Body) -> np.ndarray:
    return np.array(body.omega_B)


def momentum_N(body: Body) -> np.ndarray:
    L = I_B * omega(body)
    return np.array(rotate(body.q_NB, (L[0], L[1], L[2])))


def test_without_torque_energy_and_angular_momentum_stay() -> None:
    start = REST._replace(omega_B=(1.5, -0.8, 2.0))
    end = fly(start, 10.0, 0.001)
    # RK4 at 1 ms: the local error is of the order (omega dt)^5, some 1e-13 a second here.
    assert float(omega(end) @ (I_B * omega(end))) == pytest.approx(
        float(omega(start) @ (I_B * omega(start))), rel=1e-11
    )
    np.testing.assert_allclose(momentum_N(end), momentum_N(start), rtol=1e-10)


def test_the_integration_error_falls_with_the_fourth_power_of_the_step() -> None:
    start = REST._replace(omega_B=(3.0, -2.0, 4.0))
    inputs = {"command": Wrench((0.5, 0.0, 0.0), 0.0), "moment_B": (0.0, 0.3, 0.0), "damping": 0.02}
    ends = [np.array([*flatten(fly(start, 1.0, dt, **inputs))]) for dt in (0.02, 0.01, 0.005, 0.00125)]
    errors = [float(np.linalg.norm(end - ends[3])) for end in ends[:3]]
    assert math.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.15)
    assert math.log2(errors[1] / errors[2]) == pytest.approx(4.0, abs=0.15)


@pytest.mark.slow
def test_spin_about_the_intermediate_axis_flips_and_about_the_others_stays() -> None:
    # I_x > I_y > I_z: y is the intermediate axis (Dzhanibekov's nut).
    flips, constants = REST._replace(omega_B=(1e-3, 3.0, 1e-3)), params(0.001)
    signs = set()
    for _ in range(20000):
        flips = step(constants, flips, 0.001)
        signs.add(math.copysign(1.0, flips.omega_B[1]) if abs(flips.omega_B[1]) > 2.5 else 0.0)
    assert {-1.0, 1.0} <= signs
    for axis, spin in ((0, (3.0, 1e-3, 1e-3)), (2, (1e-3, 1e-3, 3.0))):
        stays = REST._replace(omega_B=spin)
        for _ in range(20000):
            stays = step(constants, stays, 0.001)
        assert stays.omega_B[axis] == pytest.approx(3.0, rel=1e-5)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_moment_about_an_axis_turns_about_that_axis_by_its_inertia(axis: int) -> None:
    # Constant moment, no damping: a quarter turn takes t = sqrt(pi I / moment).
    value = 0.1
    seconds = math.sqrt(math.pi * I_B[axis] / value)
    L, M, N = (value * (axis == i) for i in range(3))
    end = fly(REST, seconds, seconds / 1000.0, moment_B=(L, M, N))
    expected = [0.0, 0.0, 0.0]
    expected[axis] = math.pi / 2.0
    if axis == 1:  # at theta = 90 deg roll and yaw are not unique: look at the nose instead
        np.testing.assert_allclose(rotate(end.q_NB, (1.0, 0.0, 0.0)), (0.0, 0.0, -1.0), atol=1e-9)
    else:
        np.testing.assert_allclose(to_euler(end.q_NB), expected, atol=1e-9)
    assert omega(end)[axis] == pytest.approx(value * seconds / I_B[axis], rel=1e-12)


def test_the_yaw_equation_has_the_yaw_moment_not_the_papers_roll_moment() -> None:
    turn_B = turn_from_outside(params(0.001), (0.5, 0.0, 0.2), ZERO)
    rate = motion_rate(params(0.001), STILL, ZERO, turn_B)
    assert rate.omega_B[2] == pytest.approx(0.2 / VEHICLE.inertia_B[2])
    assert rate.omega_B[0] == pytest.approx(0.5 / VEHICLE.inertia_B[0])


def test_the_actuators_answer_as_a_first_order_lag() -> None:
    end = fly(REST, VEHICLE.actuator_lag, 0.001, command=Wrench((1.0, 0.0, 0.0), 2.0))
    assert (end.torque_B[0], end.thrust) == pytest.approx((1.0 - math.exp(-1.0), 2.0 - 2.0 * math.exp(-1.0)), rel=1e-14)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_damping_takes_the_rate_to_that_of_the_air(axis: int) -> None:
    gust = tuple(0.4 if k == axis else 0.0 for k in range(3))
    end = fly(REST, 10.0, 0.01, damping=2.0, gust_omega_B=gust)
    assert end.omega_B == pytest.approx(gust, rel=1e-8)  # 20 time constants


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_rate_decays_with_the_derived_damping_of_its_axis(axis: int) -> None:
    vehicle = load_vehicle("iris")
    start = REST._replace(omega_B=tuple(0.5 if k == axis else 0.0 for k in range(3)))
    end, constants = start, body_params(vehicle, 0.01)
    for _ in range(200):
        end = step(constants, end, 0.01)
    assert end.omega_B[axis] == pytest.approx(0.5 * math.exp(-2.0 * vehicle.rate_damping_B[axis]), rel=1e-9)


def test_a_body_that_falls_and_turns_keeps_the_velocity_of_the_air_that_stands() -> None:
    """Without forces the air falls upward past the body, in N, however the body turns."""
    constants = params(0.001)
    stages = make_stages(
        lambda _, motion, __: motion_rate(constants, motion, ZERO, ZERO), change_motion, add_motions, scale_motion
    )
    motion = Motion((3.0, -1.0, 0.5), from_euler(0.3, -0.2, 0.1), (0.8, -1.5, 2.0))
    start_N = rotate(motion.q_NB, motion.flow_B)
    for _ in range(1000):
        motion = stages(None, motion, (None,) * 4, 0.001)[1]
    fallen = (start_N[0], start_N[1], start_N[2] - GRAVITY)
    np.testing.assert_allclose(rotate(motion.q_NB, motion.flow_B), fallen, rtol=1e-11)


def test_held_does_not_move_and_feels_the_stand() -> None:
    phi, theta = 0.2, -0.1
    body = REST._replace(q_NB=from_euler(phi, theta, 0.3))
    end = fly(body, 1.0, 0.01)
    assert end.position_N == (0.0, 0.0, 0.0)
    expected = np.array([math.sin(theta), -math.sin(phi) * math.cos(theta), -math.cos(phi) * math.cos(theta)]) * GRAVITY
    np.testing.assert_allclose(held_force(body.q_NB), expected, rtol=1e-14)
