"""The paper's attitude model, linear in the state and rational in seven parameters, and its design plant at hover.

`d/dt (E, omega_B) = A(rho) (E, omega_B) + B moment_B` with `rho = (sin phi, cos phi, sin theta, cos theta, p, q, r)`
(Kumar and Bhattacharya, Eq. 3 to 5) equals the rigid body exactly. Two slips of the paper are corrected. The equation
of r-dot has N / I_z. The second rate row is `rho7/2 p + rho5/2 r`; in print it is `rho7/2 p + rho7/2 r`, which is not
q-dot. `cos(theta)` must not be 0, where the kinematics are singular, though Table II allows it.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from firmware_model.config.vehicle import Vehicle
from gustproof.robust.lti.state_space import Lti, Matrix


@dataclass(frozen=True, slots=True, kw_only=True)
class SchedulingParameter:
    """One scheduling parameter and its bounds in the paper."""

    name: str
    """Short name."""
    label: str
    """Name in mathematical type."""
    meaning: str
    """Definition in mathematical type."""
    low: float
    """[-, or rad/s] Table II, least value."""
    high: float
    """[-, or rad/s] Table II, largest value."""


RATE_BOUND = 1.5
"""[rad/s] bound on the rates in Table II."""
RATE_BOUND_IN_TEXT = 1.5 * math.pi
"""[rad/s] bound on the rates in section IV-C of the paper."""

_ANGLES = ((r"$\sin\phi$", -1.0), (r"$\cos\phi$", 0.0), (r"$\sin\theta$", -1.0), (r"$\cos\theta$", 0.0))
_BOUNDS = (
    *((meaning, low, 1.0) for meaning, low in _ANGLES),
    *((f"${rate}$ [rad/s]", -RATE_BOUND, RATE_BOUND) for rate in "pqr"),
)
PARAMETERS = tuple(
    SchedulingParameter(name=f"rho{k}", label=rf"$\rho_{k}$", meaning=meaning, low=low, high=high)
    for k, (meaning, low, high) in enumerate(_BOUNDS, start=1)
)
"""The seven parameters with the bounds of Table II."""

HOVER = (0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0)
"""[-, rad/s] the parameters at level rest."""


def scheduling_parameters(E: ArrayLike, omega_B: ArrayLike) -> Matrix:
    """Return the parameters, (..., 7), of Euler angles `E` (..., 3) [rad] and rates `omega_B` (..., 3) [rad/s] B."""
    angles, rates = np.asarray(E, dtype=np.float64), np.asarray(omega_B, dtype=np.float64)
    phi, theta = angles[..., 0], angles[..., 1]
    trigonometric = np.stack([np.sin(phi), np.cos(phi), np.sin(theta), np.cos(theta)], axis=-1)
    return np.concatenate([trigonometric, rates], axis=-1)


def lpv_matrix(rho: ArrayLike, inertia_B: ArrayLike) -> Matrix:
    """Return `A(rho)`, (6, 6), of the state (phi, theta, psi, p, q, r) [rad, rad/s].

    `rho` (7,) [-, rad/s] are the parameters, `inertia_B` (3,) [kg*m^2] B the principal moments of inertia.

    Raises
    ------
    ValueError
        If rho4 is 0: the Euler kinematics are singular there.

    References
    ----------
    T. Kumar, R. Bhattacharya, Robust Attitude Control of Nonlinear UAV Dynamics with LFT Models and H-infinity
    Performance, Eq. 3 to 5, corrected as described at the top of this module.
    """
    s_phi, c_phi, s_theta, c_theta, p, q, r = np.asarray(rho, dtype=np.float64)
    I_x, I_y, I_z = np.asarray(inertia_B, dtype=np.float64)
    if c_theta == 0.0:
        raise ValueError("rho4 = cos(theta) is 0: the Euler kinematics are singular")
    A = np.zeros((6, 6))
    A[:3, 3:] = [
        [1.0, s_phi * s_theta / c_theta, c_phi * s_theta / c_theta],
        [0.0, c_phi, -s_phi],
        [0.0, s_phi / c_theta, c_phi / c_theta],
    ]
    coupling = np.array([[(I_y - I_z) / I_x], [(I_z - I_x) / I_y], [(I_x - I_y) / I_z]])
    A[3:, 3:] = coupling * [[0.0, r / 2, q / 2], [r / 2, 0.0, p / 2], [q / 2, p / 2, 0.0]]
    return A


def airframe(vehicle: Vehicle, *, leak: ArrayLike, rate_damping: ArrayLike) -> Lti:
    """Return the airframe at hover: moment (3,) [N*m] B to its states (phi, theta, psi, p, q, r).

    The Euler kinematics have the term `-leak E`, the paper's stability augmentation: [1/s], a scalar or (3,) by axis.
    Without it the attitude is not detectable from rates and no H-infinity problem is solvable. No vehicle has it. The
    rate equations have the term `-rate_damping omega_B`: [1/s], a scalar or (3,) by axis.
    """
    A = lpv_matrix(HOVER, vehicle.inertia_B) - np.diag([*np.broadcast_to(leak, 3), *np.broadcast_to(rate_damping, 3)])
    B = np.vstack([np.zeros((3, 3)), np.diag(1.0 / np.asarray(vehicle.inertia_B))])
    return Lti(A=A, B=B, C=np.eye(6), D=np.zeros((6, 3)))


def rate_loop(vehicle: Vehicle, *, leak: ArrayLike, tau: float) -> Lti:
    """Return an airframe whose autopilot tracks rates: rate command and disturbance moment to the six states.

    Each rate follows its command with a first-order lag of `tau` [s], a rate loop seen from outside. The disturbance
    moment (3,) [N*m] B enters as angular acceleration. Inputs are rates (3,) [rad/s] B, then the moment.
    """
    A = lpv_matrix(HOVER, vehicle.inertia_B) - np.diag([*np.broadcast_to(leak, 3), *[1.0 / tau] * 3])
    B_rates = np.vstack([np.zeros((3, 3)), np.eye(3) / tau])
    B_moment = np.vstack([np.zeros((3, 3)), np.diag(1.0 / np.asarray(vehicle.inertia_B))])
    return Lti(A=A, B=np.hstack([B_rates, B_moment]), C=np.eye(6), D=np.zeros((6, 6)))


def inner_loops(vehicle: Vehicle, *, leak: ArrayLike, omega: Matrix, damping: Matrix) -> Lti:
    """Return an airframe whose autopilot tracks rates with second-order loops, each axis on its own.

    `omega'' + 2 damping omega_n omega' + omega_n^2 (omega - command) = d/dt (d / I)`, with natural frequency `omega`
    (3,) [rad/s] and `damping` (3,) [-]. The third group of states is the autopilot's share of the angular acceleration
    (3,) [rad/s^2] B: the disturbance moment is answered by it alone. Inputs and outputs as of `rate_loop`.
    """
    A = np.zeros((9, 9))
    A[:6, :6] = lpv_matrix(HOVER, vehicle.inertia_B) - np.diag([*np.broadcast_to(leak, 3), 0.0, 0.0, 0.0])
    A[3:6, 6:] = np.eye(3)
    A[6:, 3:] = np.hstack([-np.diag(omega**2), -np.diag(2.0 * damping * omega)])
    B = np.zeros((9, 6))
    B[6:, :3], B[3:6, 3:] = np.diag(omega**2), np.diag(1.0 / np.asarray(vehicle.inertia_B))
    return Lti(A=A, B=B, C=np.eye(6, 9), D=np.zeros((6, 6)))


def actuators(vehicle: Vehicle) -> Lti:
    """Return the first-order torque actuators: command (3,) [N*m] B to moment (3,) [N*m] B, their state."""
    rate = np.eye(3) / vehicle.actuator_lag
    return Lti(A=-rate, B=rate, C=np.eye(3), D=np.zeros((3, 3)))


def linear_plant(vehicle: Vehicle) -> Lti:
    """Return the vehicle at hover with its actuators: states (phi, theta, psi, p, q, r, T_L, T_M, T_N).

    Inputs are the torque command (3,) and the disturbance moment (3,) [N*m] B; outputs are the Euler angles (3,) [rad]
    and the rates (3,) [rad/s] B.
    """
    body = airframe(vehicle, leak=0.0, rate_damping=vehicle.rate_damping_B)
    motors = actuators(vehicle)
    A = np.block([[body.A, body.B], [np.zeros((3, 6)), motors.A]])
    B = np.block([[np.zeros((6, 3)), body.B], [motors.B, np.zeros((3, 3))]])
    return Lti(A=A, B=B, C=np.eye(6, 9), D=np.zeros((6, 6)))
