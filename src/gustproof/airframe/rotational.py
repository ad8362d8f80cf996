"""The rotating airframe as exact uncertain models: the least, in half-angle tangents, and the paper's in rho1..rho7.

Both equal `d/dt (E, omega_B) = A(rho) (E, omega_B)` at every attitude below |theta| = 90 deg; their Delta covers an
envelope. With `t = tan(phi/2)` and `v = tan(theta/2)` the Euler kinematics are rational of order 2 in each.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from firmware_model.config.vehicle import Vehicle
from gustproof.robust.lti.state_space import Matrix, gain
from gustproof.robust.uncertain.elements import ureal
from gustproof.robust.uncertain.uncertain_system import Uncertain, as_uncertain, join, stack, system_from_matrix


@dataclass(frozen=True, slots=True, kw_only=True)
class Envelope:
    """Range of attitudes and rates covered by a model.

    Raises
    ------
    ValueError
        If the angle is not between 0 and 90 deg, where the Euler kinematics are singular, or the rate not positive.
    """

    angle: float
    """[rad] largest |phi| and |theta|."""
    rate: float
    """[rad/s] largest |p|, |q| and |r|."""

    def __post_init__(self) -> None:
        """Check the bounds."""
        if not 0.0 < self.angle < math.pi / 2.0:
            raise ValueError(f"angle is {self.angle} rad, must be above 0 and below pi/2")
        if not (math.isfinite(self.rate) and self.rate > 0.0):
            raise ValueError(f"rate is {self.rate} rad/s, must be positive")


def rotation(inertia_B: Sequence[float | Uncertain], envelope: Envelope) -> Uncertain:
    """Return the exact rotational dynamics, (E, omega_B, moment_B) to d/dt (E, omega_B): Delta = t I2, v I2, r I2, q.

    Seven is the least order. Let `b + j a = (q + j r) e^(j phi)`. Then theta' = b, psi' = a / cos(theta),
    phi' = p + a tan(theta), and `I omega' = moment - omega x I omega`.

    Moments of inertia (3,) [kg*m^2] B may be uncertain; each uncertain one adds one inverse and two factors to Delta.
    """
    t = ureal("t", range=(-math.tan(envelope.angle / 2.0), math.tan(envelope.angle / 2.0)))
    v = ureal("v", range=(-math.tan(envelope.angle / 2.0), math.tan(envelope.angle / 2.0)))
    q, r = (ureal(name, range=(-envelope.rate, envelope.rate)) for name in ("q", "r"))
    # (b, a) = (I - t J)^-1 (I + t J) (q, r) is a rotation by phi: t acts on the sum of input and output
    J = np.array([[0.0, -1.0], [1.0, 0.0]])
    bank = join(gain(np.block([[np.eye(2), J], [2.0 * np.eye(2), J]])), stack(t, t), 2, 2)
    # (1 + v) / (1 - v) and its inverse act on a: half their difference is tan(theta), half their sum 1 / cos(theta)
    tilt = join(gain([[0.0, 0.5, 0.5], [1.0, 0.5, -0.5], [2.0, 1.0, 0.0], [2.0, 0.0, -1.0]]), stack(v, v), 2, 2)
    rotated = stack(1.0, 1.0, tilt) @ stack(1.0, bank)
    kinematics = _as_matrix([[1, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]) @ rotated
    products = stack(r, r, q) @ _as_matrix([[0, 1, 0], [1, 0, 0], [1, 0, 0]])
    return _rigid_body(kinematics, products, inertia_B)


def paper_rotation(inertia_B: Sequence[float | Uncertain], envelope: Envelope) -> Uncertain:
    """Return the same dynamics with the paper's rho1..rho7 as Delta, of order 12: a relaxation.

    Sine and cosine vary independently. Each product of rates is shared between its two factors, as in the paper's
    A(rho) (Kumar and Bhattacharya, Eq. 3, corrected). Same channels as `rotation`.
    """
    s, c = math.sin(envelope.angle), math.cos(envelope.angle)
    rho1, rho3 = (ureal(name, range=(-s, s)) for name in ("rho1", "rho3"))
    rho2, rho4 = (ureal(name, range=(c, 1.0)) for name in ("rho2", "rho4"))
    p, q, r = (ureal(f"rho{k}", range=(-envelope.rate, envelope.rate)) for k in (5, 6, 7))
    # (q, r) to (b, a), then a to (a tan(theta), a / cos(theta)): one division by rho4 serves both
    bank = (
        _as_matrix([[1, 0, 0, -1], [0, 1, 1, 0]])
        @ stack(rho2, rho2, rho1, rho1)
        @ _as_matrix(np.tile(np.eye(2), (2, 1)))
    )
    tilt = stack(rho3, 1.0) @ _as_matrix([[1], [1]]) @ rho4.inverse()
    turned = stack(1.0, 1.0, tilt) @ stack(1.0, bank)
    kinematics = _as_matrix([[1, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]) @ turned
    halves = _as_matrix(np.kron(np.eye(3), [[0.5, 0.5]])) @ stack(r, q, r, p, q, p)
    products = halves @ _as_matrix([[0, 1, 0], [0, 0, 1], [1, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0]])
    return _rigid_body(kinematics, products, inertia_B)


def uncertain_airframe(dynamics: Uncertain, *, leak: float, rate_damping: ArrayLike) -> Uncertain:
    """Return the airframe as a system: moment (3,) [N*m] B to its states (phi, theta, psi, p, q, r).

    It replaces the block "airframe" of a design problem. At delta = 0 of `rotation` it equals `lpv.airframe` with the
    same `leak` and `rate_damping` [1/s], a scalar or (3,) by axis. `dynamics` come from `rotation` or `paper_rotation`.
    """
    decay = np.hstack([-np.diag([*[leak] * 3, *np.broadcast_to(rate_damping, 3)]), np.zeros((6, 3))])
    stacked = np.vstack([np.eye(6), np.zeros((6, 6))]) @ (dynamics + decay)
    return system_from_matrix(stacked + np.block([[np.zeros((6, 9))], [np.eye(6), np.zeros((6, 3))]]), 6)


def uncertain_actuators(vehicle: Vehicle, *, lag: Uncertain | None = None, gain_: Uncertain | None = None) -> Uncertain:
    """Return the first-order actuators, torque command (3,) to moment (3,) [N*m] B, of uncertain lag [s] and gain [-].

    All three share the two parameters; the defaults are the vehicle's lag and 1.

    Examples
    --------
    >>> from gustproof import load_vehicle, uncertain_actuators, ureal
    >>> actuators = uncertain_actuators(load_vehicle("paper"), lag=ureal("lag", range=(0.07, 0.13)))
    >>> (actuators.n_inputs, actuators.M.order)
    (3, 3)
    """
    rate = as_uncertain(vehicle.actuator_lag if lag is None else lag).inverse()
    drive = as_uncertain(1.0 if gain_ is None else gain_)
    axis = stack(rate, 1.0) @ (_as_matrix([[-1, 0], [1, 0]]) + _as_matrix([[1], [0]]) @ drive @ _as_matrix([[0, 1]]))
    return stack(*[system_from_matrix(axis, 1)] * 3)


def _rigid_body(kinematics: Uncertain, products: Uncertain, inertia_B: Sequence[float | Uncertain]) -> Uncertain:
    """Return (E, omega, moment) to derivatives from omega to E' and omega to (r q, r p, q p)."""
    I_x, I_y, I_z = inertia_B
    differences = _as_matrix(np.kron(np.eye(3), [[1.0, -1.0]])) @ stack(I_y, I_z, I_z, I_x, I_x, I_y)
    gyroscopic = differences @ _as_matrix(np.kron(np.eye(3), [[1.0], [1.0]])) @ products
    rates = stack(I_x, I_y, I_z).inverse() @ (gyroscopic @ _as_matrix(np.eye(3, 6)) + _as_matrix(np.eye(3, 6, 3)))
    both = stack(kinematics, rates) @ _as_matrix(np.vstack([np.eye(3, 6), np.eye(6)]))
    return both @ _as_matrix(np.eye(6, 9, 3))


def _as_matrix(matrix: ArrayLike) -> Matrix:
    return np.asarray(matrix, dtype=np.float64)
