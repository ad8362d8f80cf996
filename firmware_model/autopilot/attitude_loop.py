"""The on-board loop: strapdown attitude from the gyro, attitude P and rate PID, torque command within the limits."""

import math
from typing import NamedTuple

from firmware_model.config.vehicle import Stabilizer, Vehicle
from firmware_model.numerics.compiled import kernel
from firmware_model.numerics.rotations import conjugate, from_rotation_vector, multiply, normalize
from firmware_model.types import Quaternion, Vector

ALIGNMENT_TIME = 3.0
"""[s] time constant of the attitude's alignment in free flight: slow beside the loops, fast beside a gyro's drift."""


class StabilizerState(NamedTuple):
    """State of the on-board loop."""

    qw: float  # strapdown q_NB at the sample
    qx: float
    qy: float
    qz: float
    p: float  # [rad/s] B, the sample before
    q: float
    r: float
    i_roll: float  # [rad] integrated rate error
    i_pitch: float
    i_yaw: float
    f_roll: float  # [rad/s] low-passed rate, of which the derivative is taken
    f_pitch: float
    f_yaw: float


class StabilizerParams(NamedTuple):
    """Gains as torque, limits, sample time."""

    angle_p: float  # [1/s]
    rate_limit: float  # [rad/s]
    smoothing: float  # [-] weight of a new sample in the derivative's low pass
    dt: float  # [s]
    p_roll: float  # [N*m*s/rad]
    p_pitch: float
    p_yaw: float
    i_roll: float  # [N*m/rad]
    i_pitch: float
    i_yaw: float
    d_roll: float  # [N*m*s^2/rad]
    d_pitch: float
    d_yaw: float
    limit_roll: float  # [N*m]
    limit_pitch: float
    limit_yaw: float


def stabilizer_params(vehicle: Vehicle, gains: Stabilizer, dt: float) -> StabilizerParams:
    """Return on-board gains for a vehicle and the sample time `dt` [s]."""
    tau = 1.0 / (2.0 * math.pi * gains.derivative_cutoff)
    I_x, I_y, I_z = vehicle.inertia_B

    def torque(gain: Vector) -> Vector:
        return gain[0] * I_x, gain[1] * I_y, gain[2] * I_z

    return StabilizerParams(
        gains.angle_p, gains.rate_limit, 1.0 - math.exp(-dt / tau), dt,
        *torque(gains.rate_p), *torque(gains.rate_i), *torque(gains.rate_d), *vehicle.torque_limit,
    )  # fmt: skip


@kernel
def update_attitude(params: StabilizerParams, x: StabilizerState, gyro_B: Vector) -> StabilizerState:
    """Return the estimate carried to a new gyro sample: a turn by the mean of the last two samples times `dt`."""
    half = 0.5 * params.dt
    turn = from_rotation_vector((half * (x.p + gyro_B[0]), half * (x.q + gyro_B[1]), half * (x.r + gyro_B[2])))
    return set_attitude(update_rates(params, x, gyro_B), normalize(multiply((x.qw, x.qx, x.qy, x.qz), turn)))


@kernel
def update_rates(params: StabilizerParams, x: StabilizerState, gyro_B: Vector) -> StabilizerState:
    """Return the estimate with the rates of a new gyro sample, and the attitude of the last one."""
    return StabilizerState(
        x.qw, x.qx, x.qy, x.qz, gyro_B[0], gyro_B[1], gyro_B[2],
        x.i_roll, x.i_pitch, x.i_yaw,
        x.f_roll + params.smoothing * (gyro_B[0] - x.f_roll),
        x.f_pitch + params.smoothing * (gyro_B[1] - x.f_pitch),
        x.f_yaw + params.smoothing * (gyro_B[2] - x.f_yaw),
    )  # fmt: skip


@kernel
def align_attitude(params: StabilizerParams, x: StabilizerState, q_NB: Quaternion) -> StabilizerState:
    """Return the estimate pulled to the true attitude with the time constant `ALIGNMENT_TIME`.

    This stands for what accelerometer, compass and GPS tell a real autopilot about its attitude.
    """
    error = multiply(conjugate((x.qw, x.qx, x.qy, x.qz)), q_NB)
    gain = 2.0 * params.dt / ALIGNMENT_TIME if error[0] >= 0.0 else -2.0 * params.dt / ALIGNMENT_TIME
    turn = from_rotation_vector((gain * error[1], gain * error[2], gain * error[3]))
    return set_attitude(x, normalize(multiply((x.qw, x.qx, x.qy, x.qz), turn)))


@kernel
def set_attitude(x: StabilizerState, q_NB: Quaternion) -> StabilizerState:
    """Return the estimate with its attitude set to `q_NB`."""
    return StabilizerState(
        q_NB[0], q_NB[1], q_NB[2], q_NB[3], x.p, x.q, x.r, x.i_roll, x.i_pitch, x.i_yaw, x.f_roll, x.f_pitch, x.f_yaw
    )


@kernel
def attitude_rates(params: StabilizerParams, x: StabilizerState, target_q_NB: Quaternion) -> Vector:
    """Return the body rates [rad/s] that turn the estimate to the target by the shorter way, within the rate limit."""
    error = multiply(conjugate((x.qw, x.qx, x.qy, x.qz)), target_q_NB)
    gain = 2.0 * params.angle_p if error[0] >= 0.0 else -2.0 * params.angle_p
    limit = params.rate_limit
    return (
        min(max(gain * error[1], -limit), limit),
        min(max(gain * error[2], -limit), limit),
        min(max(gain * error[3], -limit), limit),
    )


@kernel
def _step_pid(p: float, i: float, d: float, limit: float, dt: float, error: float, slope: float,
          integral: float) -> tuple[float, float]:  # fmt: skip
    torque = p * error + i * integral - d * slope
    within = min(max(torque, -limit), limit)
    # Anti-windup: at the limit the integral may only move back.
    holds = (torque > limit and error > 0.0) or (torque < -limit and error < 0.0)
    return within, integral if holds else integral + dt * error


@kernel
def rate_torque(params: StabilizerParams, x: StabilizerState, omega_target_B: Vector) -> tuple[StabilizerState, Vector]:
    """Return the estimate with its integrals moved on and the torque [N*m] B that tracks the body rates."""
    dt = params.dt
    # Of f' = (rate - f) / tau the sampled form is f+ - f = smoothing (rate - f), hence the slope.
    scale = params.smoothing / (dt * (1.0 - params.smoothing))
    roll, i_roll = _step_pid(params.p_roll, params.i_roll, params.d_roll, params.limit_roll, dt,
                         omega_target_B[0] - x.p, scale * (x.p - x.f_roll), x.i_roll)  # fmt: skip
    pitch, i_pitch = _step_pid(params.p_pitch, params.i_pitch, params.d_pitch, params.limit_pitch, dt,
                           omega_target_B[1] - x.q, scale * (x.q - x.f_pitch), x.i_pitch)  # fmt: skip
    yaw, i_yaw = _step_pid(params.p_yaw, params.i_yaw, params.d_yaw, params.limit_yaw, dt,
                       omega_target_B[2] - x.r, scale * (x.r - x.f_yaw), x.i_yaw)  # fmt: skip
    moved = StabilizerState(
        x.qw, x.qx, x.qy, x.qz, x.p, x.q, x.r, i_roll, i_pitch, i_yaw, x.f_roll, x.f_pitch, x.f_yaw
    )  # fmt: skip
    return moved, (roll, pitch, yaw)


@kernel
def reset_integrators(x: StabilizerState) -> StabilizerState:
    """Return the estimate with empty integrals: the on-board rate loop is not asked and must start fresh."""
    return StabilizerState(x.qw, x.qx, x.qy, x.qz, x.p, x.q, x.r, 0.0, 0.0, 0.0, x.f_roll, x.f_pitch, x.f_yaw)
