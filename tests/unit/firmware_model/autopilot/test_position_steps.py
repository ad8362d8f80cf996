"""The loops of height and position against their formulas, one step at a time."""

import math

import pytest

from firmware_model.autopilot.position_loop import (
    PositionState,
    altitude_hold,
    clear_heading,
    climb_thrust,
    initial_position_state,
    latch_heading,
    position_hold,
    position_params,
    slew_heading,
)
from firmware_model.config.vehicle import GRAVITY, load_vehicle
from firmware_model.numerics.rotations import from_euler
from firmware_model.physics.rigid_body import Body

VEHICLE, DT = load_vehicle("iris"), 0.004
GAINS, WEIGHT = VEHICLE.position, VEHICLE.mass * GRAVITY
PARAMS = position_params(VEHICLE, GAINS, DT)
EMPTY = PositionState(0.0, 0.0, 0.0, math.nan, math.nan)
ZERO = (0.0, 0.0, 0.0)
HOVER = Body((0.0, 0.0, -10.0), ZERO, (1.0, 0.0, 0.0, 0.0), ZERO, ZERO, 0.0)


def facing(*euler: float) -> Body:
    return HOVER._replace(q_NB=from_euler(*euler))


def test_loops_begin_with_nothing_integrated_and_nothing_latched():
    x = initial_position_state()
    assert x[:3] == (0.0, 0.0, 0.0)
    assert math.isnan(x.down)
    assert math.isnan(x.yaw)


@pytest.mark.parametrize(("tilt_deg", "times"), [(0.0, 1.0), (40.0, 1.0 / math.cos(math.radians(40.0))), (80.0, 2.0)])
def test_thrust_carries_the_weight_up_to_60_degrees_of_tilt(tilt_deg, times):
    assert climb_thrust(PARAMS, EMPTY, facing(math.radians(tilt_deg), 0.0, 1.0), 0.0)[1] == pytest.approx(
        min(times * WEIGHT, 0.9 * 4.0 * VEHICLE.rotors.thrust_max)
    )


@pytest.mark.parametrize(
    ("wanted", "flown"), [(0.5, 0.5), (-0.5, -0.5), (9.0, GAINS.z_velocity_max_down), (-9.0, -GAINS.z_velocity_max_up)]
)
def test_thrust_corrects_the_climb_rate_within_the_fastest_ones(wanted, flown):
    body = HOVER._replace(velocity_N=(0.0, 0.0, 0.25))
    x = EMPTY._replace(i_down=0.125)
    least, most = 0.1 * WEIGHT, 0.9 * 4.0 * VEHICLE.rotors.thrust_max
    x_next, thrust = climb_thrust(PARAMS, x, body, wanted)
    error = flown - 0.25
    free = VEHICLE.mass * (GRAVITY - GAINS.z_velocity_p * error - 0.125)
    assert thrust == pytest.approx(min(max(free, least), most))
    moves = least <= free <= most
    assert x_next.i_down == pytest.approx(0.125 + (DT * GAINS.z_velocity_i * error if moves else 0.0))


@pytest.mark.parametrize(("full", "sign"), [(-100.0, 1.0), (100.0, -1.0)])
def test_height_integral_at_a_limit_of_thrust_only_moves_back(full, sign):
    x = EMPTY._replace(i_down=full)
    limit = 0.9 * 4.0 * VEHICLE.rotors.thrust_max if full < 0.0 else 0.1 * WEIGHT
    for v_down, moves in ((0.5 * sign, True), (-0.5 * sign, False)):
        x_next, thrust = climb_thrust(PARAMS, x, HOVER, v_down)
        assert thrust == pytest.approx(limit)
        assert x_next.i_down - full == pytest.approx(DT * GAINS.z_velocity_i * v_down if moves else 0.0, abs=1e-12)


def test_height_is_held_where_it_was_entered_and_a_thrust_releases_it():
    x, thrust = altitude_hold(PARAMS, EMPTY._replace(i_north=1.0, i_east=1.0, i_down=0.5), HOVER, math.nan)
    assert (x.i_north, x.i_east, x.down) == (0.0, 0.0, -10.0)
    assert thrust == pytest.approx(WEIGHT)  # a fresh integral
    higher = HOVER._replace(position_N=(0.0, 0.0, -10.25))
    x, thrust = altitude_hold(PARAMS, x._replace(i_down=0.5), higher, math.nan)
    assert x.down == -10.0
    sink = GAINS.z_p * 0.25
    assert thrust == pytest.approx(VEHICLE.mass * (GRAVITY - GAINS.z_velocity_p * sink - 0.5))
    x, thrust = altitude_hold(PARAMS, x._replace(yaw=2.0), higher, 7.0)
    assert thrust == 7.0
    assert x[:3] == (0.0, 0.0, 0.0)
    assert math.isnan(x.down)
    assert x.yaw == 2.0


def test_position_error_is_a_velocity_and_its_error_an_acceleration():
    body = HOVER._replace(position_N=(1.0, -2.0, -10.0), velocity_N=(0.25, 0.5, 0.0))
    x = PositionState(0.125, -0.25, 0.0, -3.0, 1.0)
    x_next, (north, east, down), thrust = position_hold(PARAMS, x, body, (2.0, -2.5, -10.5), math.nan)
    e_north, e_east = GAINS.xy_p * 1.0 - 0.25, GAINS.xy_p * -0.5 - 0.5
    assert (north, east) == pytest.approx((GAINS.xy_velocity_p * e_north + 0.125, GAINS.xy_velocity_p * e_east - 0.25))
    assert down == 0.0
    integrals = (0.125 + DT * GAINS.xy_velocity_i * e_north, -0.25 + DT * GAINS.xy_velocity_i * e_east)
    assert x_next[:2] == pytest.approx(integrals)
    assert math.isnan(x_next.down)
    assert math.isnan(x_next.yaw)
    assert thrust == pytest.approx(VEHICLE.mass * (GRAVITY + GAINS.z_velocity_p * GAINS.z_p * 0.5))
    _, _, descending = position_hold(PARAMS, x, body, (2.0, -2.5, -10.5), 0.5)
    assert descending == pytest.approx(VEHICLE.mass * (GRAVITY - GAINS.z_velocity_p * 0.5))


def test_far_away_speed_and_tilt_are_at_their_limits_and_integrals_stay():
    x = PositionState(0.5, -0.5, 0.0, math.nan, math.nan)
    at_speed = HOVER._replace(velocity_N=(0.6 * GAINS.xy_velocity_max, -0.8 * GAINS.xy_velocity_max, 0.0))
    x_next, (north, east, _), _ = position_hold(PARAMS, x, at_speed, (600.0, -800.0, -10.0), math.nan)
    assert (north, east) == pytest.approx((0.5, -0.5))  # the speed is right: only the integrals act
    assert x_next[:2] == pytest.approx((0.5, -0.5))
    x_next, (north, east, _), _ = position_hold(PARAMS, EMPTY, HOVER, (600.0, -800.0, -10.0), math.nan)
    most = GRAVITY * math.tan(GAINS.tilt_max)
    assert (north, east) == pytest.approx((0.6 * most, -0.8 * most))
    assert x_next[:2] == (0.0, 0.0)


@pytest.mark.parametrize(
    ("present", "wanted", "command"),
    [(0.5, 0.6, 0.6), (0.5, 1.5, 0.7), (0.5, -1.5, 0.3), (3.0, -3.0, 3.2), (-3.0, 3.1, -3.1831853)],
)
def test_heading_is_slewed_by_the_shorter_way(present, wanted, command):
    assert slew_heading(from_euler(0.1, -0.1, present), wanted) == pytest.approx(command)


def test_heading_is_latched_once_until_it_is_cleared():
    x = latch_heading(EMPTY._replace(down=-3.0, i_down=0.5), from_euler(0.1, 0.2, 1.25))
    assert x.yaw == pytest.approx(1.25)
    assert (x.down, x.i_down) == (-3.0, 0.5)
    assert latch_heading(x, from_euler(0.0, 0.0, -2.0)) == x
    cleared = clear_heading(x)
    assert math.isnan(cleared.yaw)
    assert cleared[:4] == x[:4]
