"""The compiled step of a law, as sparse sums: most coefficients of most laws are 0.

One vector holds all summands of a step. They are states, measurements and references, Euler rates of the law's own
estimates, saturation excess, excess of the rate commanded from attitude, and outputs of a schedule. The sums are the
inputs of a schedule, the three rates of a law that limits them, the three commands, and the next states. On every route
each sum takes its terms in the order of that vector, and leaves out those whose coefficient is 0. So a limit that is
not reached adds 0 at the end of a sum and changes no bit.
"""

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_model.numerics.compiled import compiled, find_cache, kernel
from firmware_model.numerics.elementary import arctan2, sin_cos
from firmware_model.numerics.rotations import from_euler, multiply
from firmware_model.physics.sensors import float32
from firmware_model.types import Vector
from gustproof.law.form import ANGLES, BODY_RATES, GYRO_REFERENCE_SIZE, Law, Matrix, RateLimit, Schedule

MEASURED_SIZE = 9
"""Numbers of a sample after the states: gyro, reference, specific force."""
FORCE, RATES, SATURATION, RATE_EXCESS, ZERO, EXTRA_SIZE = 6, 9, 12, 15, 18, 19
"""Offsets after the states of specific force, Euler rates, saturation excess, excess of the commanded rate, and a 0;
count of the numbers after the states. A law that reads the accelerometer has roll and pitch in place of the force. Of a
law with a schedule its k outputs follow, and (k, k) numbers of work space."""
_OFFSET, _LIMIT, _FACTOR, SCHEDULE_SIZE = 0, 1, 2, 3
"""Columns of `SparseLaw.schedule` before L: offset of the parameter in the vector, its limit, factor to [-1, 1]."""
STEEP = math.pi / 3.0
"""[rad] pitch beyond which the law's own attitude moves by the exact rotation; proofs are for less."""
_NONE: Matrix = np.zeros((0, 0))
TERM_BLOCK = 4
"""Each sum has a multiple of this many terms, so that four are added at once."""


class SparseLaw(NamedTuple):
    """Nonzero terms of a law."""

    ends: NDArray[np.int64]
    """(k + 3 or 6 + n,) end of the terms of each input of a schedule, each limited rate, if there are such, each
    command and each next state."""
    terms: Matrix
    """(m, 2) offset in the vector, coefficient; sums are padded with 0 times the vector's 0."""
    is_scheduled: bool
    """True if Euler rates are among the terms."""
    is_gravity_aided: bool
    """True if roll and pitch by gravity are among the terms."""
    limits: Matrix
    """(3,) [N*m or rad/s] B, largest commands."""
    rate_limits: Matrix
    """(3,) [rad/s] largest rates commanded from attitude; unused without sums for them."""
    attitude_limits: Matrix
    """(3,) [rad] attitude estimates that ask for these rates."""
    schedule: Matrix
    """(k, SCHEDULE_SIZE + k) parameters of a schedule, and its L; k is 0 without one."""
    dt: float
    """[s] sample time."""


@lru_cache(maxsize=16)
def sparse_law(law: Law) -> SparseLaw:
    """Return the terms of a law whose coefficient is not 0, padded to blocks of `TERM_BLOCK`.

    They are kept, as a short flight takes less time than they do; nobody may change them.
    """
    own = law.rate_limit or RateLimit(S=_NONE, T=_NONE, U=_NONE, V=_NONE, limits=np.full(3, np.inf))
    turn = law.schedule or Schedule(parameters=(), limits=_NONE, J=_NONE, K=_NONE, L=_NONE, P=_NONE, Q=_NONE)
    n, k = law.order, len(turn.parameters)
    first = k + 3 * (law.rate_limit is not None)
    whole = np.zeros((first + 3 + n, n + EXTRA_SIZE + k))
    columns = (
        (0, (turn.J, own.S, law.C, law.A)),
        (n, (turn.K, own.T, law.D, law.B)),
        (n + RATES, (_NONE, _NONE, _NONE, law.G)),
        (n + SATURATION, (_NONE, _NONE, _NONE, law.H)),
        (n + RATE_EXCESS, (_NONE, _NONE, own.U, own.V)),
        (n + EXTRA_SIZE, (_NONE, _NONE, turn.P, turn.Q)),
    )
    for column, parts in columns:
        for top, part in zip((0, k, first, first + 3), parts, strict=True):
            whole[top : top + part.shape[0], column : column + part.shape[1]] = part
    filled = []
    for row in whole:
        terms = [(float(i), row[i]) for i in np.flatnonzero(row)]
        filled.append(terms + [(float(n + ZERO), 0.0)] * (-len(terms) % TERM_BLOCK if terms else TERM_BLOCK))
    ends = np.cumsum([len(terms) for terms in filled])
    every = np.array([term for terms in filled for term in terms])
    # Copied, as some of a law are read-only and some are not: kernels would be compiled for each of the two.
    limits, rates, attitude = law.limits.copy(), own.limits.copy(), law.attitude_limits.copy()
    kind = law.has_kinematics, law.uses_accelerometer
    return SparseLaw(ends, every, *kind, limits, rates, attitude, _rows_of_schedule(turn, n), law.dt)


def _rows_of_schedule(schedule: Schedule, n: int) -> Matrix:
    """Return `SparseLaw.schedule` of a law of `n` states."""
    offsets = dict(zip((*ANGLES, *BODY_RATES), (0, 1, n, n + 1, n + 2), strict=True))
    rows = np.zeros((len(schedule.parameters), SCHEDULE_SIZE + len(schedule.parameters)))
    for row, name, limit in zip(rows, schedule.parameters, schedule.limits.tolist(), strict=False):
        row[:SCHEDULE_SIZE] = offsets[name], limit, schedule_factor(name, limit)
    rows[:, SCHEDULE_SIZE:] = schedule.L
    return rows


def schedule_factor(name: str, limit: float) -> float:
    """Return the factor from a rate, or the tangent of half an angle, to its share of that at `limit`."""
    if name not in ANGLES:
        return 1.0 / limit
    sine, cosine = sin_cos(limit)
    return (1.0 + cosine) / sine


def vector_size(law: SparseLaw, order: int) -> int:
    """Return the length of the vector that a step of a law of `order` states sums, with its work space."""
    k = len(law.schedule)
    return order + EXTRA_SIZE + k * (k + 1)


def no_law() -> SparseLaw:
    """Return the terms of no law, of the types of a law's."""
    unused = np.full(3, np.inf)
    ends, schedule = np.zeros(3, dtype=np.int64), np.zeros((0, SCHEDULE_SIZE))
    return SparseLaw(ends, np.zeros((1, 2)), False, False, unused, unused, unused, schedule, 1.0)


@kernel
def tilt(force: Any, attitude: Any) -> tuple[float, float]:
    """Return roll and pitch [rad] of a body at rest with this specific force (3,) [m/s^2] B, 0 without force.

    At small angles they are -f_y / g and f_x / g. Of the angles that describe the same tilt they are those nearest to
    `attitude`, the law's own roll and pitch [rad]. So whatever the accelerometer measures, they differ from these by
    half a turn at most.
    """
    roll = arctan2(-force[1], -force[2])
    sine, cosine = sin_cos(roll)
    pitch = arctan2(force[0], -(force[1] * sine + force[2] * cosine))
    half_turns = math.floor(attitude[1] * (1.0 / math.pi) + 0.5)
    upside_down = half_turns - 2.0 * math.floor(0.5 * half_turns)  # beyond the vertical: the other description
    roll += upside_down * math.pi
    turns = math.floor((attitude[0] - roll) * (0.5 / math.pi) + 0.5)
    return roll + turns * (2.0 * math.pi), half_turns * math.pi + (1.0 - 2.0 * upside_down) * pitch


@kernel
def euler_rates(E: Any, omega: Any) -> tuple[float, float, float]:
    """Return `T(E) omega` [rad/s], the exact ZYX Euler kinematics; `cos(theta)` is kept above 0.05 in magnitude.

    The floor bounds the law near the singularity, where `turn_steep` moves the attitude.
    """
    sin_phi, cos_phi = sin_cos(E[0])
    sin_theta, cos_theta = sin_cos(E[1])
    if abs(cos_theta) < 0.05:
        cos_theta = 0.05 if cos_theta >= 0.0 else -0.05
    psi_dot = (sin_phi * omega[1] + cos_phi * omega[2]) / cos_theta
    return omega[0] + sin_theta * psi_dot, cos_phi * omega[1] - sin_phi * omega[2], psi_dot


@kernel
def turn_steep(E: Any, omega: Any, rates: Any, dt: float, after: Any) -> tuple[float, float, float]:
    """Return the next attitude [rad]; beyond `STEEP`, replace the Euler update `after` by the exact rotation.

    Near the vertical Euler rates change much within a sample. So beyond `STEEP` the angles that a turn at `omega`
    [rad/s] for `dt` [s] makes of `E` take the place of `E + dt rates`. The turn is Cayley's, short by `(|omega| dt)^3 /
    12` rad. Beyond the vertical all three angles go on by half a turn, so that pitch is within a quarter turn.
    """
    if abs(E[1]) <= STEEP:
        return after[0], after[1], after[2]
    half = 0.5 * dt
    turn = (1.0, half * omega[0], half * omega[1], half * omega[2])
    w, x, y, z = multiply(from_euler(E[0], E[1], 0.0), turn)  # not of unit length: no angle depends on it
    right, down = 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z
    phi = arctan2(right, down)
    sine, cosine = sin_cos(phi)
    theta = arctan2(2.0 * (w * y - x * z), right * sine + down * cosine)
    psi = arctan2(2.0 * (x * y + w * z), w * w + x * x - y * y - z * z)
    phi += math.floor((E[0] - phi) * (0.5 / math.pi) + 0.5) * (2.0 * math.pi)
    return (
        after[0] + (phi - E[0] - dt * rates[0]),
        after[1] + (theta - E[1] - dt * rates[1]),
        after[2] + (psi - dt * rates[2]),
    )


@kernel
def rate_excess(rates: Any, attitude: Any, limits: Any, attitude_limits: Any) -> tuple[float, float, float]:
    """Return `W(E) clip(s) - s` [rad/s] of the commanded rates `s` (3,), see `gustproof.law.form.RateLimit`.

    Of `attitude`, roll and pitch [rad], only what is beyond the limits turns the rates: within them `W` is exactly 1.
    """
    p = min(max(rates[0], -limits[0]), limits[0])
    q = min(max(rates[1], -limits[1]), limits[1])
    r = min(max(rates[2], -limits[2]), limits[2])
    sin_phi, cos_phi = sin_cos(attitude[0] - min(max(attitude[0], -attitude_limits[0]), attitude_limits[0]))
    sin_theta, cos_theta = sin_cos(attitude[1] - min(max(attitude[1], -attitude_limits[1]), attitude_limits[1]))
    across = cos_theta * r
    return (
        p - sin_theta * r - rates[0],
        cos_phi * q + sin_phi * across - rates[1],
        cos_phi * across - sin_phi * q - rates[2],
    )


@kernel
def share_of_limit(value: float, limit: float, factor: float, is_angle: bool) -> float:
    """Return delta [-] of a scheduling parameter, see `gustproof.law.form.Schedule`."""
    within = min(max(value, -limit), limit)
    if is_angle:
        sine, cosine = sin_cos(within)
        within = sine / (1.0 + cosine)
    return within * factor


@kernel
def _schedule(law: SparseLaw, z: Matrix, n: int) -> int:
    """Write the outputs of the schedule; return the end of the terms of its inputs.

    `(I - Delta L) w = Delta (J x + K y)` by elimination without pivots, see `gustproof.law.form.Schedule`.
    """
    rows, begin = law.schedule, 0
    k = rows.shape[0]
    w = z[n + EXTRA_SIZE : n + EXTRA_SIZE + k]
    m = z[n + EXTRA_SIZE + k : n + EXTRA_SIZE + k + k * k]
    for i in range(k):
        at = int(rows[i, _OFFSET])
        delta = share_of_limit(z[at], rows[i, _LIMIT], rows[i, _FACTOR], at < n)
        w[i] = delta * _sum(law.terms, begin, law.ends[i], z)
        begin = law.ends[i]
        for j in range(k):
            m[i * k + j] = (1.0 if i == j else 0.0) - delta * rows[i, SCHEDULE_SIZE + j]
    for c in range(k):
        for i in range(c + 1, k):
            share = m[i * k + c] / m[c * k + c]
            for j in range(c + 1, k):
                m[i * k + j] -= share * m[c * k + j]
            w[i] -= share * w[c]
    for i in range(k - 1, -1, -1):
        for j in range(i + 1, k):
            w[i] -= m[i * k + j] * w[j]
        w[i] /= m[i * k + i]
    return int(begin)


@kernel
def law_kernel(law: SparseLaw, z: Matrix, command: Matrix, work: Matrix) -> None:
    """Write the command for the vector `z`, see `vector_size`, and advance its states by a sample; `work` is (n,)."""
    n, k = work.size, law.schedule.shape[0]
    if law.is_gravity_aided:
        force = (z[n + FORCE], z[n + FORCE + 1], z[n + FORCE + 2])
        z[n + FORCE], z[n + FORCE + 1] = tilt(force, (z[0], z[1]))
    begin = _schedule(law, z, n)
    if law.ends.size > k + 3 + n:
        for i in range(3):
            z[n + RATE_EXCESS + i] = _sum(law.terms, begin, law.ends[k + i], z)
            begin = law.ends[k + i]
        k += 3
        rates = (z[n + RATE_EXCESS], z[n + RATE_EXCESS + 1], z[n + RATE_EXCESS + 2])
        excess = rate_excess(rates, (z[0], z[1]), law.rate_limits, law.attitude_limits)
        z[n + RATE_EXCESS], z[n + RATE_EXCESS + 1], z[n + RATE_EXCESS + 2] = excess
    for i in range(3):
        u = _sum(law.terms, begin, law.ends[k + i], z)
        command[i] = min(max(u, -law.limits[i]), law.limits[i])
        z[n + SATURATION + i] = command[i] - u
        begin = law.ends[k + i]
    if law.is_scheduled:
        z[n + RATES], z[n + RATES + 1], z[n + RATES + 2] = euler_rates((z[0], z[1], z[2]), (z[3], z[4], z[5]))
    for i in range(n):
        work[i] = _sum(law.terms, begin, law.ends[k + 3 + i], z)
        begin = law.ends[k + 3 + i]
    if law.is_scheduled:
        E, omega, rates = (z[0], z[1], z[2]), (z[3], z[4], z[5]), (z[n + RATES], z[n + RATES + 1], z[n + RATES + 2])
        work[0], work[1], work[2] = turn_steep(E, omega, rates, law.dt, (work[0], work[1], work[2]))
    for i in range(n):
        z[i] = work[i]


@kernel
def _sum(terms: Matrix, begin: int, end: int, z: Matrix) -> float:
    total = 0.0
    for t in range(begin, end):
        total += terms[t, 1] * z[int(terms[t, 0])]
    return total


@compiled
def _step(law: SparseLaw, z: Matrix, command: Matrix, work: Matrix) -> None:
    law_kernel(law, z, command, work)


def step(law: Law, x: Matrix, y: Matrix) -> tuple[Matrix, Matrix]:
    """Return the next state (n,) and the command (3,) [N*m or rad/s] B.

    `y` is gyro [rad/s], reference [rad] and specific force [m/s^2], (9,); (6,) suffices without accelerometer.

    Raises
    ------
    ValueError
        If `y` has another shape, or lacks the specific force for a law that reads it.
    """
    expected = MEASURED_SIZE if law.uses_accelerometer else GYRO_REFERENCE_SIZE
    if y.shape not in ((expected,), (MEASURED_SIZE,)):
        raise ValueError(f"y has shape {y.shape}, must be {(expected,)}")
    terms = sparse_law(law)
    z, command = np.zeros(vector_size(terms, law.order)), np.empty(3)
    z[: law.order], z[law.order : law.order + y.size] = x, y
    _step(terms, z, command, np.empty(law.order))
    return z[: law.order], command


def is_cold() -> bool:
    """Return whether the first step of a law still has to be compiled, once after an installation."""
    found = find_cache(step_packed)
    return found is not None and not found.warm


class LawStepper:
    """A law in flight, from its initial state with all states 0 and a level reference.

    Its steps give the bits of `step`. Everything is in three arrays that stay: Python passes these fastest.
    `scale` (3,) [N*m or rad/s] B is the command that is 1.0 on the wire.

    Examples
    --------
    >>> from gustproof import LawStepper, load_law
    >>> flying = LawStepper(load_law("hinf-d1"), scale=(1.0, 1.0, 1.0))
    >>> command = flying.step((0.1, 0.0, 0.0), (0.0, 0.0, -9.81))
    >>> command[0] < 0.0  # against the rate
    True
    """

    def __init__(self, law: Law, scale: Vector) -> None:
        n, summed = law.order, sparse_law(law)
        rows = summed.schedule
        # a schedule of k parameters has k (k + 3) numbers, an even count
        terms = np.vstack([summed.terms, rows.reshape(-1, 2)])
        kind = summed.is_scheduled + 2 * summed.is_gravity_aided + 4 * len(rows)
        limits = summed.limits, summed.rate_limits, summed.attitude_limits
        self._memory = np.concatenate([np.zeros(vector_size(summed, n) + n + 3), *limits, scale, [law.dt]])
        self._order, self._estimates = n, law.is_scheduled
        self.packed = PackedLaw(summed.ends, terms, kind, self._memory, n)
        """Its arrays, for kernels that step it too."""

    def restart(self, attitude: Vector | None = None) -> None:
        """Return to the initial state; the reference stays.

        With `attitude`, a law that carries an attitude estimate starts at this roll and pitch [rad], heading 0.
        """
        self._memory[: self._order] = 0.0
        if attitude is not None and self._estimates:
            self._memory[:2] = attitude[:2]

    def correct(self, attitude: Vector, share: float) -> None:
        """Move the attitude estimate of a law that carries one by a share of its distance from `attitude` [rad].

        The heading's distance is the shorter way round.
        """
        if self._estimates:
            for axis, angle in enumerate(attitude):
                away = angle - self._memory[axis]
                self._memory[axis] += share * (away - 2.0 * math.pi * round(away / (2.0 * math.pi)))

    def set_reference(self, euler: Vector) -> None:
        """Set the attitude to hold from the next step on: roll, pitch, yaw [rad]."""
        self._memory[self._order + 3 : self._order + 6] = euler

    def step(self, gyro_B: Vector, force_B: Vector) -> Vector:
        """Step with rates [rad/s] and specific force [m/s^2]; return the command as float32 fractions of `scale`."""
        ends, terms, kind, memory, _ = self.packed
        fractions: Vector = step_packed(ends, terms, kind, memory, *gyro_B, *force_B)
        return fractions


class PackedLaw(NamedTuple):
    """A law in flight in few arrays."""

    ends: NDArray[np.int64]
    """(k,) ends of the terms of each sum, see `SparseLaw`."""
    terms: Matrix
    """(m, 2) those of `SparseLaw`, units there, then its schedule."""
    kind: int
    """Sum of 1 with Euler rates, 2 with roll and pitch by gravity, and 4 for each parameter of a schedule."""
    memory: Matrix
    """(n,) the vector of a step, work space, command, limits, scale and sample time, each with its own unit."""
    order: int
    """Count of states, which come first in the memory; the reference is in it from `order + 3` on."""


@compiled
def step_packed(ends: NDArray[np.int64], terms: Matrix, kind: int, memory: Matrix, p: float, q: float, r: float,
                force_x: float, force_y: float, force_z: float) -> Vector:  # fmt: skip
    """Step a `PackedLaw` with rates [rad/s] and specific force [m/s^2]; see `LawStepper.step`."""
    k = kind // 4
    n = (memory.size - EXTRA_SIZE - k * (k + 1) - 16) // 2
    end = n + EXTRA_SIZE + k * (k + 1)
    z, work, command, rest = memory[:end], memory[end : end + n], memory[end + n : end + n + 3], memory[end + n + 3 :]
    limits, rate_limits, attitude_limits, scale = rest[:3], rest[3:6], rest[6:9], rest[9:12]
    z[n], z[n + 1], z[n + 2] = p, q, r
    z[n + FORCE], z[n + FORCE + 1], z[n + FORCE + 2] = force_x, force_y, force_z
    schedule = terms[terms.shape[0] - k * (k + SCHEDULE_SIZE) // 2 :].reshape(k, k + SCHEDULE_SIZE)
    is_gravity_aided = kind % 4 >= 2
    law = SparseLaw(
        ends, terms, kind % 2 == 1, is_gravity_aided, limits, rate_limits, attitude_limits, schedule, rest[12]
    )
    law_kernel(law, z, command, work)
    return float32(command[0] / scale[0]), float32(command[1] / scale[1]), float32(command[2] / scale[2])
