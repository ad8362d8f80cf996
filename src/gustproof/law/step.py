"""The compiled step of a law, as sparse sums: most coefficients of most laws are 0.

One vector holds all summands of a step: states, measurements and references, Euler rates of the law's own estimates,
and saturation excess. The sums are the three commands and the next states. On every route each sum takes its terms in
the order of that vector, without those whose coefficient is 0.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_model.numerics.compiled import compiled, kernel
from firmware_model.numerics.elementary import sin_cos
from firmware_model.physics.sensors import float32
from firmware_model.types import Vector
from gustproof.law.form import MEASUREMENT_SIZE, Law, Matrix

RATES, SATURATION, ZERO, EXTRA_SIZE = MEASUREMENT_SIZE, MEASUREMENT_SIZE + 3, MEASUREMENT_SIZE + 6, MEASUREMENT_SIZE + 7
"""Offsets after the states of Euler rates, saturation excess and a 0; count of the numbers after the states."""
TERM_BLOCK = 4
"""Each sum has a multiple of this many terms, so that four are added at once."""


class SparseLaw(NamedTuple):
    """Nonzero terms of a law."""

    ends: NDArray[np.int64]
    """(3 + n,) end of the terms of each command and each next state."""
    terms: Matrix
    """(m, 2) offset in the vector, coefficient; sums are padded with 0 times the vector's 0."""
    is_scheduled: bool
    """True if Euler rates are among the terms."""
    limits: Matrix
    """(3,) [N*m or rad/s] B."""


def sparse_law(law: Law) -> SparseLaw:
    """Return the terms of a law whose coefficient is not 0, padded to blocks of `TERM_BLOCK`."""
    n, measured = law.order, law.D.shape[1]
    whole = np.zeros((3 + n, n + EXTRA_SIZE))
    whole[:3, :n], whole[3:, :n] = law.C, law.A
    whole[:3, n : n + measured], whole[3:, n : n + measured] = law.D, law.B
    whole[3:, n + RATES : n + SATURATION], whole[3:, n + SATURATION : n + ZERO] = law.G, law.H
    filled = []
    for row in whole:
        terms = [(float(i), row[i]) for i in np.flatnonzero(row)]
        filled.append(terms + [(float(n + ZERO), 0.0)] * (-len(terms) % TERM_BLOCK if terms else TERM_BLOCK))
    ends = np.cumsum([len(terms) for terms in filled])
    return SparseLaw(ends, np.array([term for terms in filled for term in terms]), law.is_scheduled, law.limits)


@kernel
def euler_rates(E: Any, omega: Any) -> tuple[float, float, float]:
    """Return `T(E) omega` [rad/s], the exact ZYX Euler kinematics; `cos(theta)` is kept above 0.05 in magnitude.

    The floor bounds the law near the singularity; within |theta| < 87 deg the kinematics are exact.
    """
    sin_phi, cos_phi = sin_cos(E[0])
    sin_theta, cos_theta = sin_cos(E[1])
    if abs(cos_theta) < 0.05:
        cos_theta = 0.05 if cos_theta >= 0.0 else -0.05
    psi_dot = (sin_phi * omega[1] + cos_phi * omega[2]) / cos_theta
    return omega[0] + sin_theta * psi_dot, cos_phi * omega[1] - sin_phi * omega[2], psi_dot


@kernel
def law_kernel(law: SparseLaw, z: Matrix, command: Matrix, work: Matrix) -> None:
    """Write the command for the vector `z` (n + EXTRA_SIZE,) and advance its states by a sample; `work` is (n,)."""
    n, begin = work.size, 0
    for i in range(3):
        u = _sum(law.terms, begin, law.ends[i], z)
        command[i] = min(max(u, -law.limits[i]), law.limits[i])
        z[n + SATURATION + i] = command[i] - u
        begin = law.ends[i]
    if law.is_scheduled:
        z[n + RATES], z[n + RATES + 1], z[n + RATES + 2] = euler_rates((z[0], z[1], z[2]), (z[3], z[4], z[5]))
    for i in range(n):
        work[i] = _sum(law.terms, begin, law.ends[3 + i], z)
        begin = law.ends[3 + i]
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
    """Return the next state (n,) and the command (3,) [N*m or rad/s] B for `y`, (9,), or (6,) without accelerometer.

    Raises
    ------
    ValueError
        If `y` has another shape, or lacks the specific force for a law that reads it.
    """
    if y.shape not in ((law.D.shape[1],), (MEASUREMENT_SIZE,)):
        raise ValueError(f"y has shape {y.shape}, must be {(law.D.shape[1],)}")
    z, command = np.zeros(law.order + EXTRA_SIZE), np.empty(3)
    z[: law.order], z[law.order : law.order + y.size] = x, y
    _step(sparse_law(law), z, command, np.empty(law.order))
    return z[: law.order], command


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
        self._ends, self._terms, self._scheduled = summed.ends, summed.terms, summed.is_scheduled
        self._memory = np.concatenate([np.zeros(2 * n + EXTRA_SIZE + 3), law.limits, scale])
        self._order = n

    def restart(self) -> None:
        """Return to the initial state; the reference stays."""
        self._memory[: self._order] = 0.0

    def set_reference(self, euler: Vector) -> None:
        """Set the attitude to hold from the next step on: roll, pitch, yaw [rad]."""
        self._memory[self._order + 3 : self._order + 6] = euler

    def step(self, gyro_B: Vector, force_B: Vector) -> Vector:
        """Step with rates [rad/s] and specific force [m/s^2]; return the command as float32 fractions of `scale`."""
        fractions: Vector = _step_packed(self._ends, self._terms, self._scheduled, self._memory, *gyro_B, *force_B)
        return fractions


@compiled
def _step_packed(ends: NDArray[np.int64], terms: Matrix, scheduled: bool, memory: Matrix, p: float, q: float, r: float,
         force_x: float, force_y: float, force_z: float) -> Vector:  # fmt: skip
    n = ends.size - 3
    end = n + EXTRA_SIZE
    z, work, command = memory[:end], memory[end : end + n], memory[end + n : end + n + 3]
    limits, scale = memory[end + n + 3 : end + n + 6], memory[end + n + 6 :]
    z[n], z[n + 1], z[n + 2] = p, q, r
    z[n + 6], z[n + 7], z[n + 8] = force_x, force_y, force_z
    law_kernel(SparseLaw(ends, terms, scheduled, limits), z, command, work)
    return float32(command[0] / scale[0]), float32(command[1] / scale[1]), float32(command[2] / scale[2])
