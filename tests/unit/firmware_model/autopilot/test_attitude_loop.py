"""The on-board attitude loop against its formulas, one step at a time."""

import math
from dataclasses import replace

import pytest

from firmware_model.autopilot.attitude_loop import (
    StabilizerParams,
    StabilizerState,
    align_attitude,
    attitude_rates,
    follow_torque,
    rate_torque,
    reset_integrators,
    set_attitude,
    stabilizer_params,
    update_attitude,
    update_rates,
)
from firmware_model.config.vehicle import load_vehicle
from firmware_model.numerics.rotations import conjugate, from_euler, from_rotation_vector, multiply, to_euler

VEHICLE, DT = load_vehicle("paper"), 0.004
ALIGNMENT_TIME, TRIM_TIME = 3.0, 0.25
GAINS = replace(
    VEHICLE.stabilizer, rate_p=(14.0, 15.0, 16.0), rate_i=(20.0, 21.0, 22.0), rate_d=(0.8, 0.9, 1.0), rate_limit=3.0
)
PARAMS = stabilizer_params(VEHICLE, GAINS, DT)
LEVEL = StabilizerState(1.0, *[0.0] * 12)
AXES = pytest.mark.parametrize("axis", [0, 1, 2])


def along(axis: int, value: float) -> tuple[float, float, float]:
    return tuple(value if k == axis else 0.0 for k in range(3))


def attitude(x: StabilizerState) -> tuple[float, float, float, float]:
    return x.qw, x.qx, x.qy, x.qz


@AXES
def test_gains_are_torques_for_the_vehicles_inertia(axis):
    inertia = VEHICLE.inertia_B[axis]
    assert PARAMS[4 + axis] == pytest.approx(GAINS.rate_p[axis] * inertia)
    assert PARAMS[7 + axis] == pytest.approx(GAINS.rate_i[axis] * inertia)
    assert PARAMS[10 + axis] == pytest.approx(GAINS.rate_d[axis] * inertia)
    assert PARAMS[13 + axis] == VEHICLE.torque_limit[axis]


def test_derivative_is_low_passed_at_its_cutoff():
    # A first-order lag of 1 / (2 pi f) leaves exp(-2 pi f dt) of a step after one sample.
    assert PARAMS.smoothing == pytest.approx(1.0 - math.exp(-2.0 * math.pi * GAINS.derivative_cutoff * DT))
    x = LEVEL
    for _ in range(3):
        x = update_rates(PARAMS, x, (1.0, -2.0, 3.0))
    reached = 1.0 - (1.0 - PARAMS.smoothing) ** 3
    assert (x.f_roll, x.f_pitch, x.f_yaw) == pytest.approx((reached, -2.0 * reached, 3.0 * reached))
    assert (x.p, x.q, x.r) == (1.0, -2.0, 3.0)


@AXES
def test_attitude_turns_by_the_mean_of_two_samples(axis):
    x = update_rates(PARAMS, LEVEL, along(axis, 1.0))
    assert attitude(x) == (1.0, 0.0, 0.0, 0.0)  # rates alone turn nothing
    x = update_attitude(PARAMS, x, along(axis, 2.0))
    assert attitude(x) == pytest.approx(from_rotation_vector(along(axis, 1.5 * DT)))
    assert x[4 + axis] == 2.0


@AXES
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_alignment_takes_out_an_error_with_its_time_constant(axis, sign):
    start = set_attitude(LEVEL, from_euler(0.3, -0.2, 1.0))
    true = multiply(attitude(start), from_rotation_vector(along(axis, 0.1)))
    x = align_attitude(PARAMS, start, tuple(sign * number for number in true))  # both quaternions are one attitude

    def turned() -> tuple[float, float, float]:
        return to_euler(multiply(conjugate(attitude(start)), attitude(x)))

    assert turned() == pytest.approx(along(axis, 0.1 * DT / ALIGNMENT_TIME), rel=2e-3, abs=1e-12)
    for _ in range(round(ALIGNMENT_TIME / DT)):
        x = align_attitude(PARAMS, x, true)
    assert turned() == pytest.approx(along(axis, 0.1 * (1.0 - math.exp(-1.0))), rel=5e-3, abs=1e-12)


def test_set_attitude_keeps_everything_else():
    x = StabilizerState(*(0.1 * number for number in range(13)))
    assert set_attitude(x, (0.5, -0.5, 0.5, -0.5)) == (0.5, -0.5, 0.5, -0.5, *x[4:])
    assert reset_integrators(x) == (*x[:7], 0.0, 0.0, 0.0, *x[10:])


@AXES
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_rate_command_leads_to_the_target_by_the_shorter_way_within_its_limit(axis, sign):
    x = set_attitude(LEVEL, from_euler(0.3, -0.2, 1.0))
    for angle, rate in ((0.02, GAINS.angle_p * 0.02), (-0.02, -GAINS.angle_p * 0.02), (2.0, 3.0), (-2.0, -3.0)):
        target = multiply(attitude(x), from_rotation_vector(along(axis, angle)))
        rates = attitude_rates(PARAMS, x, tuple(sign * number for number in target))
        assert rates == pytest.approx(along(axis, rate), rel=1e-4, abs=1e-12)


@AXES
def test_half_a_turn_goes_the_way_of_its_quaternion(axis):
    for sign in (1.0, -1.0):
        assert attitude_rates(PARAMS, LEVEL, (0.0, *along(axis, sign))) == along(axis, sign * GAINS.rate_limit)


def unlimited(**changes: float) -> StabilizerParams:
    return PARAMS._replace(limit_roll=100.0, limit_pitch=100.0, limit_yaw=100.0, **changes)


@AXES
def test_rate_pid_is_its_formula(axis):
    inertia = VEHICLE.inertia_B[axis]
    x = LEVEL._replace(**{("i_roll", "i_pitch", "i_yaw")[axis]: 0.05})
    x = update_rates(PARAMS, x, along(axis, 0.5))
    x_next, torque = rate_torque(unlimited(), x, along(axis, 0.75))
    # The low pass f moved by s * rate from 0, which is f' dt of f' = (rate - f) / tau, tau = dt (1 - s) / s.
    s = PARAMS.smoothing
    slope = s / (DT * (1.0 - s)) * (0.5 - 0.5 * s)
    pid = GAINS.rate_p[axis] * 0.25 + GAINS.rate_i[axis] * 0.05 - GAINS.rate_d[axis] * slope
    assert torque == pytest.approx(along(axis, inertia * pid))
    assert x_next[7 + axis] == pytest.approx(0.05 + DT * 0.25)
    assert attitude(x_next) == attitude(x)


@AXES
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_integral_at_the_limit_only_moves_back(axis, sign):
    limit = VEHICLE.torque_limit[axis]
    full = LEVEL._replace(**{("i_roll", "i_pitch", "i_yaw")[axis]: sign * 100.0})
    held, torque = rate_torque(PARAMS, full, along(axis, sign * 0.1))
    assert torque == along(axis, sign * limit)
    assert held == full
    moved, torque = rate_torque(PARAMS, full, along(axis, -sign * 0.1))
    assert torque == along(axis, sign * limit)
    assert moved[7 + axis] == pytest.approx(sign * (100.0 - 0.1 * DT))
    just = rate_torque(unlimited(), LEVEL, along(axis, sign))[1]
    at_limit = PARAMS._replace(**{("limit_roll", "limit_pitch", "limit_yaw")[axis]: abs(just[axis])})
    assert rate_torque(at_limit, LEVEL, along(axis, sign))[0][7 + axis] == pytest.approx(sign * DT)  # not beyond it yet


@AXES
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_integrals_follow_an_outside_torque_with_their_time_constant(axis, sign):
    outside = along(axis, 0.5 * sign * VEHICLE.torque_limit[axis])
    full = outside[axis] / (VEHICLE.inertia_B[axis] * GAINS.rate_i[axis])
    for steps in (1, round(TRIM_TIME / DT), round(10.0 * TRIM_TIME / DT)):
        x = LEVEL
        for _ in range(steps):
            x = follow_torque(PARAMS, x, outside)
        share = 1.0 - math.exp(-steps * DT / TRIM_TIME)
        assert x[7:10] == pytest.approx(along(axis, full * share))
    assert attitude(x) == (1.0, 0.0, 0.0, 0.0)
    _, torque = rate_torque(PARAMS, x, (0.0, 0.0, 0.0))  # takes over with the moment that the other one gave
    assert torque == pytest.approx(outside, rel=1e-4)


def test_an_axis_without_an_integral_follows_no_torque():
    params = stabilizer_params(VEHICLE, replace(GAINS, rate_i=(0.0, 21.0, 22.0)), DT)
    x = follow_torque(params, LEVEL, (1.0, 0.0, 0.0))
    assert x[7:10] == (0.0, 0.0, 0.0)
