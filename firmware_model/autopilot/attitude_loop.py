"""On-board attitude loop: strapdown attitude from the gyro, attitude P, rate PID, and torque within limits."""

import math
from typing import NamedTuple

from firmware_model.config.vehicle import Stabilizer, Vehicle
from firmware_model.exact import exp
from firmware_model.numerics.compiled import kernel
from firmware_model.numerics.rotations import conjugate, from_rotation_vector, multiply, normalize
from firmware_model.types import Quaternion, Vector

ALIGNMENT_TIME = 3.0
"""[s] time constant of the attitude alignment in free flight: slow beside the loops, fast beside gyro drift."""
TRIM_TIME = 0.25
"""[s] time constant with which the integrals follow an outside torque: of gusts; gyro noise averages out."""
_PidGains = tuple[float, float, float, float]  # P [N*m*s/rad], I [N*m/rad], D [N*m*s^2/rad], limit [N*m]


class StabilizerState(NamedTuple):
    """State of the on-board attitude loop."""

    qw: float  # strapdown q_NB at the sample
    qx: float
    qy: float
    qz: float
    p: float  # [rad/s] B, of the last gyro sample
    q: float
    r: float
    i_roll: float  # [rad] integrated rate error
    i_pitch: float
    i_yaw: float
    f_roll: float  # [rad/s] low-passed rate, for the derivative
    f_pitch: float
    f_yaw: float


class StabilizerParams(NamedTuple):
    """Gains as torque, limits, sample time."""

    angle_p: float  # [1/s]
    rate_limit: float  # [rad/s]
    smoothing: float  # [-] weight of a new sample in the low pass of the derivative
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
    following: float  # [-] weight of a new torque in the integrals that follow it
    per_roll: float  # [rad/(N*m)] integral per torque; 0 without an integral gain
    per_pitch: float
    per_yaw: float


def stabilizer_params(vehicle: Vehicle, gains: Stabilizer, dt: float) -> StabilizerParams:
    """Return on-board gains for a vehicle and the sample time `dt` [s]."""
    tau = 1.0 / (2.0 * math.pi * gains.derivative_cutoff)
    I_x, I_y, I_z = vehicle.inertia_B

    def torque(gain: Vector) -> Vector:
        return gain[0] * I_x, gain[1] * I_y, gain[2] * I_z

    smoothing = 1.0 - exp(-dt / tau)
    pid = *torque(gains.rate_p), *torque(gains.rate_i), *torque(gains.rate_d)
    following = 1.0 - exp(-dt / TRIM_TIME)
    per_torque = (1.0 / gain if gain > 0.0 else 0.0 for gain in torque(gains.rate_i))
    return StabilizerParams(
        gains.angle_p, gains.rate_limit, smoothing, dt, *pid, *vehicle.torque_limit, following, *per_torque
    )


@kernel
def update_attitude(params: StabilizerParams, x: StabilizerState, gyro_B: Vector) -> StabilizerState:
    """Return the state after a new gyro sample, rotated by the mean of the last two samples times `dt`."""
    half = 0.5 * params.dt
    rotation = from_rotation_vector((half * (x.p + gyro_B[0]), half * (x.q + gyro_B[1]), half * (x.r + gyro_B[2])))
    return set_attitude(update_rates(params, x, gyro_B), normalize(multiply((x.qw, x.qx, x.qy, x.qz), rotation)))


@kernel
def update_rates(params: StabilizerParams, x: StabilizerState, gyro_B: Vector) -> StabilizerState:
    """Return the state with the rates of a new gyro sample, and the attitude of the last one."""
    qw, qx, qy, qz, _, _, _, i_roll, i_pitch, i_yaw, f_roll, f_pitch, f_yaw = x
    p, q, r = gyro_B
    f_roll = f_roll + params.smoothing * (p - f_roll)
    f_pitch = f_pitch + params.smoothing * (q - f_pitch)
    f_yaw = f_yaw + params.smoothing * (r - f_yaw)
    return StabilizerState(qw, qx, qy, qz, p, q, r, i_roll, i_pitch, i_yaw, f_roll, f_pitch, f_yaw)


@kernel
def align_attitude(params: StabilizerParams, x: StabilizerState, q_NB: Quaternion) -> StabilizerState:
    """Return the state with its attitude pulled to the true one, with the time constant `ALIGNMENT_TIME`.

    This stands for the corrections of a real autopilot by accelerometer, compass and GPS.
    """
    error = multiply(conjugate((x.qw, x.qx, x.qy, x.qz)), q_NB)
    gain = 2.0 * params.dt / ALIGNMENT_TIME if error[0] >= 0.0 else -2.0 * params.dt / ALIGNMENT_TIME
    rotation = from_rotation_vector((gain * error[1], gain * error[2], gain * error[3]))
    return set_attitude(x, normalize(multiply((x.qw, x.qx, x.qy, x.qz), rotation)))


@kernel
def set_attitude(x: StabilizerState, q_NB: Quaternion) -> StabilizerState:
    """Return the state with its attitude set to `q_NB`."""
    return StabilizerState(
        q_NB[0], q_NB[1], q_NB[2], q_NB[3], x.p, x.q, x.r, x.i_roll, x.i_pitch, x.i_yaw, x.f_roll, x.f_pitch, x.f_yaw
    )


@kernel
def attitude_rates(params: StabilizerParams, x: StabilizerState, target_q_NB: Quaternion) -> Vector:
    """Return body rates [rad/s] from the estimated attitude to the target by the shorter way, within the rate limit."""
    error = multiply(conjugate((x.qw, x.qx, x.qy, x.qz)), target_q_NB)
    gain = 2.0 * params.angle_p if error[0] >= 0.0 else -2.0 * params.angle_p
    limit = params.rate_limit
    return (
        min(max(gain * error[1], -limit), limit),
        min(max(gain * error[2], -limit), limit),
        min(max(gain * error[3], -limit), limit),
    )


@kernel
def _step_pid(gains: _PidGains, dt: float, error: float, slope: float, integral: float) -> tuple[float, float]:
    p, i, d, limit = gains
    torque = p * error + i * integral - d * slope
    within = min(max(torque, -limit), limit)
    # Anti-windup: at the limit the integral may only move back.
    holds = (torque > limit and error > 0.0) or (torque < -limit and error < 0.0)
    return within, integral if holds else integral + dt * error


@kernel
def rate_torque(params: StabilizerParams, x: StabilizerState, omega_target_B: Vector) -> tuple[StabilizerState, Vector]:
    """Return the state after one step of the rate PID, and its torque [N*m] B."""
    dt = params.dt
    # f' = (rate - f) / tau is sampled as f+ - f = smoothing (rate - f), hence the slope.
    scale = params.smoothing / (dt * (1.0 - params.smoothing))
    slope = (scale * (x.p - x.f_roll), scale * (x.q - x.f_pitch), scale * (x.r - x.f_yaw))
    roll_gains = (params.p_roll, params.i_roll, params.d_roll, params.limit_roll)
    pitch_gains = (params.p_pitch, params.i_pitch, params.d_pitch, params.limit_pitch)
    yaw_gains = (params.p_yaw, params.i_yaw, params.d_yaw, params.limit_yaw)
    roll, i_roll = _step_pid(roll_gains, dt, omega_target_B[0] - x.p, slope[0], x.i_roll)
    pitch, i_pitch = _step_pid(pitch_gains, dt, omega_target_B[1] - x.q, slope[1], x.i_pitch)
    yaw, i_yaw = _step_pid(yaw_gains, dt, omega_target_B[2] - x.r, slope[2], x.i_yaw)
    return _set_integrators(x, (i_roll, i_pitch, i_yaw)), (roll, pitch, yaw)


@kernel
def follow_torque(params: StabilizerParams, x: StabilizerState, torque_B: Vector) -> StabilizerState:
    """Return the state with integrals that follow the torque [N*m] B of an outside controller.

    A rate PID that takes over thus begins with the moment that the air needed of late.
    """
    weight = params.following
    i_roll = x.i_roll + weight * (params.per_roll * torque_B[0] - x.i_roll)
    i_pitch = x.i_pitch + weight * (params.per_pitch * torque_B[1] - x.i_pitch)
    i_yaw = x.i_yaw + weight * (params.per_yaw * torque_B[2] - x.i_yaw)
    return _set_integrators(x, (i_roll, i_pitch, i_yaw))


@kernel
def reset_integrators(x: StabilizerState) -> StabilizerState:
    """Return the state with empty integrals, for a fresh start of the rate PID after a time without it."""
    return _set_integrators(x, (0.0, 0.0, 0.0))


@kernel
def _set_integrators(x: StabilizerState, integrals: Vector) -> StabilizerState:
    qw, qx, qy, qz, p, q, r, _, _, _, f_roll, f_pitch, f_yaw = x
    i_roll, i_pitch, i_yaw = integrals
    return StabilizerState(qw, qx, qy, qz, p, q, r, i_roll, i_pitch, i_yaw, f_roll, f_pitch, f_yaw)
