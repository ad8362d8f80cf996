"""Model predictive control with input limits, free of offset, solved by OSQP.

Each axis has a linear model: attitude, rate, torque behind the actuator's lag, the command that has not acted yet, and
a constant disturbance moment. A Kalman filter on the gyro estimates rate, torque and disturbance. The steady state that
holds the reference against this disturbance is the target, so there is no offset. Attitude is strapdown; the deviation
from the reference is axis times angle.

The cost of a sample is `attitude^2 + rate_time^2 rate^2 + weight (u - u_before)^2`, summed for ever. The commands
are `u_k = u_target - K z_k + c_k`, where `K` is the gain that minimises it without limits. `z` is the deviation from
the target and `c` the correction over a horizon, 0 after it. Completed squares leave `sum c_k^2`, and the programme

    minimise sum c_k^2   subject to   -limit <= u_k <= limit,

whose solution without active limits is `c = 0`, to the bit. It is solved only where some predicted command is beyond
its limit. Corrections are held over blocks of samples, and limits are kept at the first sample of each.

OSQP runs a fixed number of iterations at a fixed step size and looks at no clock, so flights repeat. It is
warm-started by the previous solution. Added: the deviation of attitude is shortened until it commands no more than the
rate limit of all laws here.

References
----------
J. A. Rossiter, B. Kouvaritakis, M. J. Rice, A numerically robust state-space approach to stable-predictive control
strategies, Automatica 34 (1998), 65-73: corrections around the optimal gain.
G. Pannocchia, J. B. Rawlings, Disturbance models for offset-free model-predictive control, AIChE Journal 49 (2003),
426-437.
B. Stellato, G. Banjac, P. Goulart, A. Bemporad, S. Boyd, OSQP: an operator splitting solver for quadratic programs,
Mathematical Programming Computation 12 (2020), 637-672.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy

from firmware_model.config.vehicle import Vehicle
from firmware_model.errors import ConfigError
from firmware_model.types import Vector
from gustproof.guide.examples.rotations import HeldAttitude, as_vector, pick_gains, rotation_vector, shorten
from gustproof.robust.lti.state_space import Lti, Matrix, discretize_zoh

BLOCKS, BLOCK = 10, 8
"""Corrections in the horizon, and samples in each: .32 s at 250 Hz."""
_ZERO: Vector = (0.0, 0.0, 0.0)
_SETTINGS = {
    "verbose": False,
    "adaptive_rho": False,
    "rho": 20.0,
    "max_iter": 25,
    "check_termination": 25,
    "polishing": False,
    "warm_starting": True,
    "time_limit": 1e10,
}
"""Of OSQP, in units of the torque limits: 25 iterations leave errors of 1e-4. The time limit never acts."""
_TUNED = {
    "paper": (
        (153.25990205194645, 0.09059442153716, 13.771039006353524, 0.46244151624147284),
        (163.89326429304768, 0.08645675845700702, 14.256663658916688, 0.5055388971213819),
        (182.5762201211088, 0.08615394117129298, 15.87058349155267, 1.3890734600526957),
    ),
    "iris": (
        (243.4601177552591, 0.0822119858773347, 24.592369533875992, 1.5427411005041167),
        (227.11160727860303, 0.06503898112317022, 19.816572849199467, 1.4872863947524204),
        (81.17312248723768, 0.6244302710884398, 24.677408764253258, 0.3889256144315462),
    ),
}
"""Weights as `MpcGains` names them, tuned in turbulence."""


class MpcGains(NamedTuple):
    """Weights of one axis, as frequencies and a time."""

    bandwidth: float
    """[rad/s] b in the weight `(b^3 J dt)^-2` of the command's change: that of the attitude loop without the rest."""
    rate_time: float
    """[s] weight of the rate beside attitude."""
    disturbance_bandwidth: float
    """[rad/s] f of the filter: the disturbance walks by `J f^2 dt` a sample, in units of the gyro's noise."""
    torque_bandwidth: float
    """[rad/s] f of the filter: the torque is uncertain by `J f^2 dt` a sample, in units of the gyro's noise."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AxisController:
    """Model, gain and filter of one axis. The model's states are attitude, rate, torque and the pending command."""

    A: Matrix
    """(4, 4) states to next states."""
    B: Matrix
    """(4,) command to next states."""
    K: Matrix
    """(4,) [N*m] per deviation of the states from the target."""
    filter_A: Matrix
    """(3, 3) rate, torque and disturbance to the next ones."""
    filter_B: Matrix
    """(3,) command that acts to the next ones."""
    filter_gain: Matrix
    """(3,) innovation of the gyro to rate, torque and disturbance."""


def design_axis(gains: MpcGains, inertia: float, lag: float, damping: float, dt: float) -> AxisController:
    """Return gain and filter of an axis, both by Riccati equations; commands act a sample late.

    `inertia` is in [kg*m^2], the actuator's `lag` and the sample time `dt` in [s], the rate's `damping` in [1/s].
    """
    rates = np.array([[0.0, 1.0, 0.0], [0.0, -damping, 1.0 / inertia], [0.0, 0.0, -1.0 / lag]])
    inputs = np.array([[0.0, 0.0], [0.0, 1.0 / inertia], [1.0 / lag, 0.0]])
    held = discretize_zoh(Lti(A=rates, B=inputs, C=np.eye(3), D=np.zeros((3, 2))), dt)
    A, B = np.zeros((4, 4)), np.eye(4)[:, 3:]
    A[:3, :3], A[:3, 3] = held.A, held.B[:, 0]
    # both Riccati equations in units of their frequencies, which keeps them well conditioned
    b = gains.bandwidth
    unit = np.array([1.0, b, inertia * b * b, inertia * b * b])
    scaled, R = A * unit / unit[:, None], np.array([[(b * dt) ** -2]])
    Q, S = np.diag([1.0, (b * gains.rate_time) ** 2, 0.0, R[0, 0]]), -R * np.eye(4)[:, 3:]
    P = scipy.linalg.solve_discrete_are(scaled, B, Q, R, s=S)
    weight = B.T @ P @ B + R
    K = np.linalg.solve(weight, B.T @ P @ scaled + S.T)[0] * unit[3] / unit
    F = np.eye(3)
    F[:2, :2], F[:2, 2] = held.A[1:, 1:], held.B[1:, 1]
    walk = np.array([0.0, gains.torque_bandwidth, gains.disturbance_bandwidth]) * dt
    unit = np.array([1.0, inertia * gains.torque_bandwidth, inertia * gains.disturbance_bandwidth])
    X = scipy.linalg.solve_discrete_are((F * unit / unit[:, None]).T, np.eye(3)[:, :1], np.diag(walk**2), np.eye(1))
    gain = unit * X[:, 0] / (X[0, 0] + 1.0)
    acting = np.append(held.B[1:, 0], 0.0)
    return AxisController(A=A, B=B[:, 0], K=K, filter_A=F, filter_B=acting, filter_gain=gain)


def predictions(design: AxisController) -> tuple[Matrix, Matrix]:
    """Return predicted deviations of the command at each block: (BLOCKS, 4) by the state, (BLOCKS, BLOCKS) by `c`."""
    closed = design.A - np.outer(design.B, design.K)
    states, moves = np.eye(4), np.zeros((4, BLOCKS))
    by_state, by_move = np.zeros((BLOCKS, 4)), np.zeros((BLOCKS, BLOCKS))
    for block in range(BLOCKS):
        by_state[block], by_move[block] = -design.K @ states, -design.K @ moves
        by_move[block, block] += 1.0
        for _ in range(BLOCK):
            states, moves = closed @ states, closed @ moves
            moves[:, block] += design.B
    return by_state, by_move


def _load_osqp() -> Any:
    """Return the package OSQP.

    Raises
    ------
    ConfigError
        If it is not installed.
    """
    try:
        import osqp
    except ImportError:
        raise ConfigError("controller mpc: OSQP is not installed: pip install 'gustproof[mpc]'") from None
    return osqp


class _Programme:
    """The quadratic programme of three axes, in units of the torque limits."""

    def __init__(self, designs: Sequence[AxisController], limits: Vector) -> None:
        found = [predictions(design) for design in designs]
        # per unit of the limit: the state's share, its largest magnitudes, and the moves'
        self._by_state = [by_state / limit for (by_state, _), limit in zip(found, limits, strict=True)]
        self._most = [tuple(np.abs(rows).max(axis=0).tolist()) for rows in self._by_state]
        self._limits, count = limits, 3 * BLOCKS
        matrix: Any = scipy.sparse.block_diag([by_move for _, by_move in found], format="csc")
        self._solver = _load_osqp().OSQP()
        free = np.ones(count)
        self._solver.setup(
            scipy.sparse.identity(count, format="csc"), np.zeros(count), matrix, -free, free, **_SETTINGS
        )

    def restart(self) -> None:
        """Forget the previous solution."""
        self._solver.warm_start(x=np.zeros(3 * BLOCKS), y=np.zeros(3 * BLOCKS))

    def correct(self, states: Sequence[tuple[float, ...]], disturbances: Sequence[float]) -> Vector:
        """Return the first corrections [N*m] for deviations (3, 4) and disturbances (3,) [N*m]."""
        if all(map(self._is_free, self._most, states, disturbances, self._limits)):
            return _ZERO
        commands = np.concatenate([rows @ np.array(z) for rows, z in zip(self._by_state, states, strict=True)])
        offsets = np.repeat([d / limit for d, limit in zip(disturbances, self._limits, strict=True)], BLOCKS)
        commands -= offsets
        if np.abs(commands).max() <= 1.0:
            return _ZERO
        self._solver.update(l=-1.0 - commands, u=1.0 - commands)
        found = self._solver.solve(raise_error=False).x
        x, y, z = (limit * float(found[k * BLOCKS]) for k, limit in enumerate(self._limits))
        return x, y, z

    @staticmethod
    def _is_free(most: tuple[float, ...], z: tuple[float, ...], disturbance: float, limit: float) -> bool:
        """Return whether a bound shows that no predicted command of an axis reaches its limit."""
        reach = sum(map(lambda a, b: a * abs(b), most, z))
        return reach + abs(disturbance) / limit <= 1.0


class Mpc:
    """The law in flight, from level at rest."""

    def __init__(self, vehicle: Vehicle, gains: Sequence[MpcGains]) -> None:
        self._vehicle, self._gains = vehicle, tuple(gains)
        self._limit, self._rate_limit = vehicle.torque_limit, vehicle.stabilizer.rate_limit
        self._attitude, self._dt = HeldAttitude(), 0.0
        self._programme: _Programme | None = None
        _load_osqp()
        self.reset()

    def reset(self) -> None:
        """Return to level, at rest."""
        self._attitude.reset()
        self._filters = [_ZERO, _ZERO, _ZERO]
        self._pending = _ZERO
        if self._programme is not None:
            self._programme.restart()

    def _start(self, dt: float) -> None:
        """Design the law for a sample time [s]."""
        v = self._vehicle
        self._dt = dt
        designs = [
            design_axis(g, J, v.actuator_lag, damping, dt)
            for g, J, damping in zip(self._gains, v.inertia_B, v.rate_damping_B, strict=True)
        ]
        self._K = [tuple(design.K.tolist()) for design in designs]
        self._ratio = [K[0] / K[1] for K in self._K]
        self._L = [tuple(design.filter_gain.tolist()) for design in designs]
        self._F = [
            (*design.filter_A[0].tolist(), design.filter_B[0], design.filter_A[1, 1], design.filter_B[1])
            for design in designs
        ]
        self._programme = _Programme(designs, self._limit)

    def step(self, gyro: Iterable[float], reference: Iterable[float], force: Iterable[float], dt: float) -> Vector:
        """Return the torque [N*m] B for a gyro sample [rad/s]; the specific force is not read."""
        if dt != self._dt:
            self._start(dt)
        rates = as_vector(gyro)
        e = rotation_vector(*self._attitude.update(rates, as_vector(reference), dt))
        r1, r2, r3 = self._ratio
        s = shorten((r1 * e[0], r2 * e[1], r3 * e[2]), self._rate_limit)
        angles = s[0] / r1, s[1] / r2, s[2] / r3
        states, disturbances, unlimited, filters = [], [], [], []
        for k in range(3):
            rate, torque, moment = self._filters[k]
            innovation, (l1, l2, l3), pending = rates[k] - rate, self._L[k], self._pending[k]
            rate, torque, moment = rate + l1 * innovation, torque + l2 * innovation, moment + l3 * innovation
            a, b, c, d, keep, share = self._F[k]
            filters.append((a * rate + b * torque + c * moment + d * pending, keep * torque + share * pending, moment))
            z = angles[k], rate, torque + moment, pending + moment
            k1, k2, k3, k4 = self._K[k]
            states.append(z)
            disturbances.append(moment)
            unlimited.append(-(k1 * z[0] + k2 * z[1] + k3 * z[2] + k4 * z[3]) - moment)
        assert self._programme is not None
        c1, c2, c3 = self._programme.correct(states, disturbances)
        (u1, u2, u3), (L, M, N) = unlimited, self._limit
        command = min(max(u1 + c1, -L), L), min(max(u2 + c2, -M), M), min(max(u3 + c3, -N), N)
        self._filters, self._pending = filters, command
        return command


def make(vehicle: Vehicle) -> Mpc:
    """Return the law for a vehicle.

    Raises
    ------
    ConfigError
        If OSQP is not installed.
    """
    return Mpc(vehicle, [MpcGains(*each) for each in pick_gains(_TUNED, vehicle)])
