"""What the ground does to the points that touch it, against a plain sum over them."""

import math

import numpy as np
import pytest

from firmware_model.config.vehicle import GRAVITY, load_vehicle
from firmware_model.numerics.rotations import from_euler, rotate
from firmware_model.physics.aerodynamics import Air, FreeInputs, FreeParams, air_params, fly, sensor_wrench, surround
from firmware_model.physics.ground import can_touch_ground, ground_params, ground_wrench, is_at_rest, standing_height
from firmware_model.physics.rigid_body import Body, Wrench, body_params

VEHICLE = load_vehicle("paper")
PARAMS = ground_params(VEHICLE)
CREEP = 0.05  # [m/s] below which friction is viscous


ZERO = (0.0, 0.0, 0.0)


def a_body(height: float, attitude=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0), omega=(0.0, 0.0, 0.0)) -> Body:
    return Body((0.0, 0.0, -height), velocity, from_euler(*attitude), omega, ZERO, 0.0)


def points() -> np.ndarray:
    """Return all that can touch, (8, 3) [m] B."""
    signs = np.array([(ahead, right, 1.0) for ahead in (-1.0, 1.0) for right in (-1.0, 1.0)])
    return np.vstack([signs * PARAMS.foot_B, signs * PARAMS.rotor_B])


def heights(body: Body) -> np.ndarray:
    """Return how high above ground each of `points` is [m]."""
    return np.array([-body.position_N[2] - rotate(body.q_NB, tuple(point))[2] for point in points()])


def summed(body: Body) -> tuple[np.ndarray, np.ndarray, float]:
    """Return force B, moment B and load: springs, dampers and Coulomb friction, point by point in B."""
    q_NB = body.q_NB
    R_NB = np.column_stack([rotate(q_NB, tuple(axis)) for axis in np.eye(3)])
    force, moment, load = np.zeros(3), np.zeros(3), 0.0
    for point in points():
        depth = body.position_N[2] + (R_NB @ point)[2]
        if depth > 0.0:
            v_N = np.array(body.velocity_N) + R_NB @ np.cross(body.omega_B, point)
            push = max(PARAMS.stiffness * depth + PARAMS.damping * v_N[2], 0.0)
            rub = PARAMS.friction * push / max(np.hypot(v_N[0], v_N[1]), CREEP)
            F_B = R_NB.T @ (-rub * v_N[0], -rub * v_N[1], -push)
            force, moment, load = force + F_B, moment + np.cross(point, F_B), load + push
    return force, moment, load


@pytest.mark.parametrize(
    ("body", "below"),
    [
        (a_body(PARAMS.foot_B[2] - 0.01), 4),
        (a_body(PARAMS.foot_B[2] - 0.01, velocity=(1.0, -0.5, 0.2), omega=(0.1, -0.2, 0.3)), 4),
        (a_body(PARAMS.foot_B[2], (0.2, -0.1, 2.0), (0.01, 0.02, 0.5), (-1.0, 0.5, 0.2)), 2),
        (a_body(0.1, (3.0, 0.2, -1.0), (-2.0, 0.0, 0.3), (0.2, 0.1, -1.0)), 1),
        (a_body(0.1, (1.6, 0.1, 0.5), (0.0, 0.3, 1.0), (0.5, 0.0, 0.0)), 4),
        (a_body(PARAMS.foot_B[2] - 0.01, velocity=(0.0, 0.0, -5.0)), 4),  # it leaves faster than the springs follow
    ],
    ids=["level", "sliding", "askew", "on its back", "on its side", "leaving"],
)  # fmt: skip
def test_force_and_moment_are_the_sum_over_the_points_that_touch(body, below):
    assert np.count_nonzero(heights(body) < 0.0) == below
    force, moment, load = ground_wrench(PARAMS, body)
    wanted = summed(body)
    tiny = 1e-14 * PARAMS.stiffness * PARAMS.reach
    np.testing.assert_allclose(force, wanted[0], rtol=1e-12, atol=tiny)
    np.testing.assert_allclose(moment, wanted[1], rtol=1e-12, atol=tiny)
    assert load == pytest.approx(wanted[2], rel=1e-12)


def test_what_cannot_touch_within_a_step_is_told():
    rng = np.random.default_rng(1)
    missed = 0
    for _ in range(300):
        turn, velocity = rng.uniform(-3.0, 3.0, 3), rng.uniform(-20.0, 20.0, 3)
        body, dt = a_body(rng.uniform(0.0, 0.5), turn, velocity), 0.002
        later = (0.0, 0.0, body.position_N[2] + dt * body.velocity_N[2])
        lowest = min(heights(body).min(), heights(body._replace(position_N=later)).min())
        missed += not can_touch_ground(PARAMS, body, dt)
        assert can_touch_ground(PARAMS, body, dt) or lowest > 0.0
        assert can_touch_ground(PARAMS, body, 0.0) or heights(body).min() > 0.0
    assert 50 < missed < 250
    for height in (PARAMS.reach + 0.02, 1000.0, np.nan):
        assert not can_touch_ground(PARAMS, a_body(height), 0.0)


STANDING = a_body(standing_height(VEHICLE))
WEIGHT = VEHICLE.mass * GRAVITY


@pytest.mark.parametrize(
    ("body", "force", "moment", "resting"),
    [
        (STANDING, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), True),
        (a_body(standing_height(VEHICLE), (0.0, 0.0, 2.5)), (0.0, 0.0, -0.4 * WEIGHT), (0.1, -0.1, 0.1), True),
        (STANDING._replace(velocity_N=(0.03, 0.0, 0.0)), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), False),
        (STANDING._replace(omega_B=(0.0, 0.0, -0.03)), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), False),
        (a_body(standing_height(VEHICLE), (0.1, 0.0, 0.0)), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), False),  # on two feet
        (STANDING, (0.0, 0.0, -0.5 * WEIGHT), (0.0, 0.0, 0.0), True),
        (STANDING, (0.0, 0.0, -0.6 * WEIGHT), (0.0, 0.0, 0.0), False),
        (STANDING, (0.0, 1.1 * PARAMS.friction * WEIGHT, 0.0), (0.0, 0.0, 0.0), False),
        (STANDING, (0.0, 0.0, 0.0), (0.0, 0.0, PARAMS.reach * PARAMS.friction * WEIGHT), False),
        (STANDING, (0.0, 0.0, 0.0), (1.1 * PARAMS.foot_B[1] * WEIGHT, 0.0, 0.0), False),
        (STANDING, (0.0, 0.0, 0.0), (0.0, -1.1 * PARAMS.foot_B[0] * WEIGHT, 0.0), False),
    ],
    ids=["motors off", "thrust", "moves", "turns", "tilted", "half", "lifts", "slides", "spins", "tips", "tips ahead"],
)  # fmt: skip
def test_it_rests_while_its_feet_can_carry_what_acts(body, force, moment, resting):
    assert is_at_rest(PARAMS, body, force, moment) is resting


LIMITS = {
    "speed": lambda share: ({"velocity_N": tuple(0.02 * share * part / 3.0 for part in (2.0, 1.0, -2.0))}, ZERO, ZERO),
    "rate": lambda share: ({"omega_B": tuple(0.02 * share * part / 3.0 for part in (2.0, 1.0, -2.0))}, ZERO, ZERO),
    "ahead": lambda share: ({}, (0.05 * WEIGHT * share, 0.0, 0.0), ZERO),
    "right": lambda share: ({}, (0.0, -0.05 * WEIGHT * share, 0.0), ZERO),
    "aslant": lambda share: ({}, (-0.03 * WEIGHT * share, 0.04 * WEIGHT * share, 0.0), ZERO),
    "pressed": lambda share: ({}, (0.075 * WEIGHT * share, 0.0, 0.5 * WEIGHT), ZERO),
    "yaw": lambda share: (
        {},
        ZERO,
        (0.0, 0.0, -0.05 * WEIGHT * share * math.hypot(*PARAMS.foot_B[:2])),
    ),
    "roll": lambda share: ({}, ZERO, (-PARAMS.foot_B[1] * WEIGHT * share, 0.0, 0.0)),
    "pitch": lambda share: ({}, ZERO, (0.0, PARAMS.foot_B[0] * WEIGHT * share, 0.0)),
    "lift": lambda share: ({}, (0.0, 0.0, -0.5 * WEIGHT * share), ZERO),
}


@pytest.mark.parametrize("limit", LIMITS)
@pytest.mark.parametrize("share", [0.99, 1.01])
def test_each_limit_of_rest_holds_up_to_its_value(limit, share):
    changes, force, moment = LIMITS[limit](share)
    slippery = PARAMS._replace(friction=0.05)
    assert is_at_rest(slippery, STANDING._replace(**changes), force, moment) is (share < 1.0)


def test_it_rests_only_while_all_four_feet_press_whichever_way_it_leans():
    rng, rested = np.random.default_rng(2), 0
    light = PARAMS._replace(friction=10.0)
    for _ in range(400):
        body = a_body(standing_height(VEHICLE) + rng.uniform(-0.01, 0.0), tuple(rng.normal(0.0, 0.02, 3).tolist()))
        press = bool((heights(body)[:4] < 0.0).all())
        assert bool(is_at_rest(light, body, ZERO, ZERO)) is press
        rested += press
    assert 50 < rested < 350


@pytest.mark.parametrize("moving", ["velocity_N", "omega_B"])
def test_what_moves_at_two_hundredths_rests_and_any_faster_does_not(moving):
    for speed, resting in ((0.02, True), (math.nextafter(0.02, 1.0), False)):
        for axis in range(3):
            motion = {moving: tuple(speed * (axis == each) for each in range(3))}
            assert is_at_rest(PARAMS, STANDING._replace(**motion), ZERO, ZERO) is resting


@pytest.mark.parametrize("share", [0.99, 1.01])
@pytest.mark.parametrize("lift", [0.0, 0.25])
@pytest.mark.parametrize(("ahead", "right"), [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)])
def test_a_force_at_the_centre_of_mass_tips_it_over_its_feet(ahead, right, lift, share):
    rough = PARAMS._replace(friction=10.0, foot_B=(0.15, *PARAMS.foot_B[1:]))
    foot_x, foot_y, foot_z = rough.foot_B
    most = share * (1.0 - lift) * WEIGHT * (foot_x if ahead else foot_y) / foot_z
    force = (ahead * most, right * most, -lift * WEIGHT)
    assert is_at_rest(rough, STANDING, force, (0.0, 0.0, 0.0)) is (share < 1.0)


def test_springs_carry_the_weight_at_their_sag_and_swing_no_more():
    assert ground_wrench(PARAMS, STANDING)[2] == pytest.approx(WEIGHT)
    # Four legs in parallel: critical damping is 2 sqrt(k m).
    assert 4.0 * PARAMS.damping == pytest.approx(2.0 * math.sqrt(4.0 * PARAMS.stiffness * VEHICLE.mass))


def test_far_from_the_ground_it_is_not_asked_about():
    params = FreeParams(body_params(VEHICLE, 0.001), air_params(VEHICLE), PARAMS)
    air, outside = Air((3.0, -1.0, 0.5), (2.0, 1.0, 0.0)), surround(params.body, params.air, 0.5, ZERO)
    high = a_body(0.6, (0.1, -0.2, 0.3), (1.0, 2.0, -1.0), (0.1, 0.2, 0.3))._replace(thrust=90.0)
    inputs = [FreeInputs(Wrench(ZERO, 0.0), outside, air, low) for low in (True, False)]
    assert sensor_wrench(params, high, inputs[0]) == sensor_wrench(params, high, inputs[1])
    assert fly(params, high, inputs[0], 0.001, 4) == fly(params, high, inputs[1], 0.001, 4)
    assert fly(params, STANDING, inputs[0], 0.001, 4) != fly(params, STANDING, inputs[1], 0.001, 4)


def test_at_rest_in_the_wind_gravity_alone_is_felt():
    params = FreeParams(body_params(VEHICLE, 0.001), air_params(VEHICLE), PARAMS)
    air, outside = Air((3.0, -1.0, 0.5), (2.0, 1.0, 0.0)), surround(params.body, params.air, 0.5, ZERO)
    inputs, creeping = FreeInputs(Wrench(ZERO, 0.0), outside, air, True), STANDING._replace(velocity_N=(0.03, 0.0, 0.0))
    assert sensor_wrench(params, STANDING, inputs)[0] == pytest.approx((0.0, 0.0, -GRAVITY), abs=1e-12)
    assert abs(sensor_wrench(params, creeping, inputs)[0][0]) > 0.01
