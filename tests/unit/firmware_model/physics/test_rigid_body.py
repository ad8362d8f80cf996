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
    BodyInputs,
    BodyParams,
    body_params,
    free_derivative,
    get_motion,
    join,
    make_stages,
    move_motion,
    specific_force,
    step_attitude,
    with_unit_length,
)

VEHICLE = load_vehicle("paper")
I_B = np.array(VEHICLE.inertia_B)
ZERO = (0.0, 0.0, 0.0)
NOTHING = BodyInputs(ZERO, ZERO, ZERO, ZERO, 0.0)
REST = Body(ZERO, ZERO, (1.0, 0.0, 0.0, 0.0), ZERO, ZERO, 0.0)


def params(*, free: bool = False, damping: float = 0.0) -> BodyParams:
    return body_params(VEHICLE, free=free)._replace(damping_x=damping, damping_y=damping, damping_z=damping)


def step(constants: BodyParams, body: Body, inputs: BodyInputs, dt: float) -> Body:
    """Step as `step_attitude` does; in free flight the airframe alone, by its derivative."""
    if not constants.free:
        return step_attitude(constants, body, inputs, dt)
    stages = make_stages(
        lambda _, motion, given: free_derivative(constants, join(motion, ZERO, 0.0), given), move_motion
    )
    return join(with_unit_length(stages(None, get_motion(body), (inputs,) * 4, dt)[1]), ZERO, 0.0)


def fly(body: Body, constants: BodyParams, inputs: BodyInputs, seconds: float, dt: float) -> Body:
    for _ in range(round(seconds / dt)):
        body = step(constants, body, inputs, dt)
    return body


def omega(body: Body) -> np.ndarray:
    return np.array(body.omega_B)


def momentum_N(body: Body) -> np.ndarray:
    L = I_B * omega(body)
    return np.array(rotate(body.q_NB, (L[0], L[1], L[2])))


@pytest.mark.compiled
def test_without_torque_energy_and_angular_momentum_stay() -> None:
    start = REST._replace(omega_B=(1.5, -0.8, 2.0))
    end = fly(start, params(), NOTHING, 10.0, 0.001)
    # RK4 at 1 ms: the local error is of the order (omega dt)^5, some 1e-13 a second here.
    assert float(omega(end) @ (I_B * omega(end))) == pytest.approx(
        float(omega(start) @ (I_B * omega(start))), rel=1e-11
    )
    np.testing.assert_allclose(momentum_N(end), momentum_N(start), rtol=1e-10)


def test_the_integration_error_falls_with_the_fourth_power_of_the_step() -> None:
    start = REST._replace(omega_B=(3.0, -2.0, 4.0))
    inputs = NOTHING._replace(torque_command_B=(0.5, 0.0, 0.0), moment_B=(0.0, 0.3, 0.0))
    ends = [
        np.array([*flatten(fly(start, params(damping=0.02), inputs, 1.0, dt))]) for dt in (0.02, 0.01, 0.005, 0.00125)
    ]
    errors = [float(np.linalg.norm(end - ends[3])) for end in ends[:3]]
    assert math.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.15)
    assert math.log2(errors[1] / errors[2]) == pytest.approx(4.0, abs=0.15)


@pytest.mark.compiled
def test_spin_about_the_intermediate_axis_flips_and_about_the_others_stays() -> None:
    # I_x > I_y > I_z: y is the intermediate axis (Dzhanibekov's nut).
    flips = fly(REST._replace(omega_B=(1e-3, 3.0, 1e-3)), params(), NOTHING, 0.0, 0.001)
    signs = set()
    for _ in range(20000):
        flips = step(params(), flips, NOTHING, 0.001)
        signs.add(math.copysign(1.0, flips.omega_B[1]) if abs(flips.omega_B[1]) > 2.5 else 0.0)
    assert {-1.0, 1.0} <= signs
    for axis, spin in ((0, (3.0, 1e-3, 1e-3)), (2, (1e-3, 1e-3, 3.0))):
        stays = REST._replace(omega_B=spin)
        for _ in range(20000):
            stays = step(params(), stays, NOTHING, 0.001)
        assert stays.omega_B[axis] == pytest.approx(3.0, rel=1e-5)


@pytest.mark.compiled
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_moment_about_an_axis_turns_about_that_axis_by_its_inertia(axis: int) -> None:
    # Constant moment, no damping: a quarter turn takes t = sqrt(pi I / moment).
    value = 0.1
    seconds = math.sqrt(math.pi * I_B[axis] / value)
    L, M, N = (value * (axis == i) for i in range(3))
    end = REST
    for _ in range(1000):
        end = step(params(), end, NOTHING._replace(moment_B=(L, M, N)), seconds / 1000.0)
    expected = [0.0, 0.0, 0.0]
    expected[axis] = math.pi / 2.0
    if axis == 1:  # at theta = 90 deg roll and yaw are not unique: look at the nose instead
        np.testing.assert_allclose(rotate(end.q_NB, (1.0, 0.0, 0.0)), (0.0, 0.0, -1.0), atol=1e-9)
    else:
        np.testing.assert_allclose(to_euler(end.q_NB), expected, atol=1e-9)
    assert omega(end)[axis] == pytest.approx(value * seconds / I_B[axis], rel=1e-12)


def test_the_yaw_equation_has_the_yaw_moment_not_the_papers_roll_moment() -> None:
    rate = free_derivative(params(), REST, NOTHING._replace(moment_B=(0.5, 0.0, 0.2)))
    assert rate.omega_B[2] == pytest.approx(0.2 / VEHICLE.inertia_B[2])
    assert rate.omega_B[0] == pytest.approx(0.5 / VEHICLE.inertia_B[0])


def test_the_actuators_answer_as_a_first_order_lag() -> None:
    end = fly(REST, params(), NOTHING._replace(torque_command_B=(1.0, 0.0, 0.0)), VEHICLE.actuator_lag, 0.001)
    assert end.torque_B[0] == pytest.approx(1.0 - math.exp(-1.0), rel=1e-8)  # RK4 of exp at h = 1/50


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_damping_takes_the_rate_to_that_of_the_air(axis: int) -> None:
    gust = tuple(0.4 if k == axis else 0.0 for k in range(3))
    end = fly(REST, params(damping=2.0), NOTHING._replace(gust_omega_B=gust), 10.0, 0.01)
    assert end.omega_B == pytest.approx(gust, rel=1e-8)  # 20 time constants


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_rate_decays_with_the_derived_damping_of_its_axis(axis: int) -> None:
    vehicle = load_vehicle("iris")
    start = REST._replace(omega_B=tuple(0.5 if k == axis else 0.0 for k in range(3)))
    end = fly(start, body_params(vehicle, free=False), NOTHING, 2.0, 0.01)
    assert end.omega_B[axis] == pytest.approx(0.5 * math.exp(-2.0 * vehicle.rate_damping_B[axis]), rel=1e-9)


def test_a_free_body_falls_as_galileo_found() -> None:
    end = fly(REST._replace(velocity_N=(3.0, 0.0, 0.0)), params(free=True), NOTHING, 2.0, 0.01)
    fallen = (end.position_N[0], end.position_N[2], end.velocity_N[2])
    assert fallen == pytest.approx((6.0, 0.5 * GRAVITY * 4.0, GRAVITY * 2.0), rel=1e-12)


def test_thrust_equal_to_weight_hovers_and_is_what_the_accelerometer_feels() -> None:
    inputs = NOTHING._replace(force_B=(0.0, 0.0, -VEHICLE.mass * GRAVITY))
    end = fly(REST, params(free=True), inputs, 2.0, 0.01)
    assert (end.position_N[2], end.velocity_N[2]) == pytest.approx((0.0, 0.0), abs=1e-12)
    assert specific_force(params(free=True), REST, inputs) == pytest.approx((0.0, 0.0, -GRAVITY), rel=1e-15)


def test_held_does_not_move_and_feels_the_stand() -> None:
    phi, theta = 0.2, -0.1
    body = REST._replace(q_NB=from_euler(phi, theta, 0.3))
    end = fly(body, params(), NOTHING, 1.0, 0.01)
    assert end.position_N == (0.0, 0.0, 0.0)
    expected = np.array([math.sin(theta), -math.sin(phi) * math.cos(theta), -math.cos(phi) * math.cos(theta)]) * GRAVITY
    np.testing.assert_allclose(specific_force(params(), body, NOTHING), expected, rtol=1e-14)
