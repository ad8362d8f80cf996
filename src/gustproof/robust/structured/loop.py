"""The closed loop of a structured controller: its spectral abscissa, H-infinity and H2 norm, with their gradients.

A controller of order n is the static gain `M = [A, B; C, D]` of the plant augmented by n integrators. All results are
functions of M; gradients are analytic, (rows of M, columns of M).

A sampled loop is treated by its bilinear transform `z = (1 + s dt/2) / (1 - s dt/2)`, exactly: the controller's delays
become `1/z`, so M keeps its numbers. The transform keeps stability and H-infinity norms.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from gustproof.robust.lti.norms import Peak, eigenvalues
from gustproof.robust.lti.state_space import ComplexMatrix, Lti, Matrix, PartedPlant, part

_ACCURACY = 1e-8
"""[-] relative accuracy of the H-infinity norm during a search; the result is computed again to the last digit."""
_ON_AXIS = 1e-3
"""[-] eigenvalues with a real part below this fraction of their magnitude are tried as crossings. Where the gain is
flat, as at an optimum, rounding moves them far off the axis. A wrong candidate costs one frequency response."""
_ROUNDING = 1e-10
"""[-] eigenvalues nearer to the axis than this fraction of the largest count as on it."""
_ROUNDS = 30
"""Largest number of rounds that raise a lower bound; two or three are usual."""


class BranchSlope(NamedTuple):
    """Value and gradient of one active branch of a function of M."""

    value: float
    """[-, or rad/s for an abscissa]."""
    gradient: Matrix
    """(rows, columns) derivative with respect to each entry of M."""


def augment_plant(P: Lti, n_meas: int, n_con: int, order: int, dt: float = 0.0) -> PartedPlant:
    """Return `P`, its last outputs and inputs being measurements and controls, augmented by `order` integrators.

    The controller is then a gain from y, its own states and the measurements, to u, their derivatives and the controls.
    With a sample time `dt` [s], `P` is the bilinear transform of a sampled plant, and each integrator is that of a
    delay: `1/z = 2 / (1 + s dt/2) - 1`.
    """
    plant, k = part(P, n_meas, n_con), order
    identity = np.eye(k)
    pole, output, feedthrough = (-2.0 / dt, 4.0 / dt, -1.0) if dt else (0.0, 1.0, 0.0)
    return PartedPlant(
        A=scipy.linalg.block_diag(plant.A, pole * identity),
        B1=np.vstack([plant.B1, np.zeros((k, plant.B1.shape[1]))]),
        B2=np.block([[np.zeros((P.order, k)), plant.B2], [identity, np.zeros((k, n_con))]]),
        C1=np.hstack([plant.C1, np.zeros((plant.C1.shape[0], k))]),
        C2=np.block([[np.zeros((k, P.order)), output * identity], [plant.C2, np.zeros((n_meas, k))]]),
        D11=plant.D11,
        D12=np.hstack([np.zeros((plant.D12.shape[0], k)), plant.D12]),
        D21=np.vstack([np.zeros((k, plant.D21.shape[1])), plant.D21]),
        D22=scipy.linalg.block_diag(feedthrough * identity, plant.D22),
    )


class ClosedLoop(NamedTuple):
    """A closed loop at one M, and the effect of a change of M: `dA = B2 dM C2`, `dB = B2 dM D21`, and so on."""

    A: Matrix
    """(n, n)."""
    B: Matrix
    """(n, m1) of w."""
    C: Matrix
    """(p1, n) of z."""
    D: Matrix
    """(p1, m1)."""
    B2: Matrix
    """(n, r) of a change of M's output."""
    C2: Matrix
    """(c, n) of M's input."""
    D12: Matrix
    """(p1, r) of a change of M's output."""
    D21: Matrix
    """(c, m1) of M's input."""


def close_loop(plant: PartedPlant, M: Matrix) -> ClosedLoop:
    """Return the closed loop `u = M y`; its numbers are not finite if it is not well posed."""
    B2, C2, D12, D21 = plant.B2, plant.C2, plant.D12, plant.D21
    if plant.D22.any():
        loop = np.eye(M.shape[0]) - M @ plant.D22
        E = np.linalg.inv(loop) if abs(np.linalg.det(loop)) > 1e-9 else np.full(loop.shape, np.nan)
        F = np.eye(M.shape[1]) + plant.D22 @ E @ M
        M, B2, D12 = E @ M, B2 @ E, D12 @ E
        A, B, C, D = _closed_matrices(plant, M)
        return ClosedLoop(A, B, C, D, B2, F @ C2, D12, F @ D21)
    A, B, C, D = _closed_matrices(plant, M)
    return ClosedLoop(A, B, C, D, B2, C2, D12, D21)


def _closed_matrices(plant: PartedPlant, M: Matrix) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    left, feedthrough = plant.B2 @ M, plant.D12 @ M
    return (
        plant.A + left @ plant.C2,
        plant.B1 + left @ plant.D21,
        plant.C1 + feedthrough @ plant.C2,
        plant.D11 + feedthrough @ plant.D21,
    )


def abscissa(A: Matrix) -> float:
    """Return the largest real part of an eigenvalue [rad/s]; infinite if `A` is not finite."""
    return float(np.max(eigenvalues(A).real)) if np.all(np.isfinite(A)) else np.inf


@dataclass(frozen=True, slots=True, kw_only=True)
class PoleMeasure:
    """A real function of a pole: its growth [1/s] or its size [rad/s, or - of a sampled loop]."""

    dt: float = 0.0
    """[s] sample time; 0 if continuous."""
    transformed: bool = False
    """True if the poles are those of the bilinear transform of a sampled loop."""
    size: bool = False
    """True for the size, False for the growth: the real part, or `log|z| / dt` of a sampled loop."""

    def of(self, values: ComplexMatrix) -> tuple[Matrix, ComplexMatrix]:
        """Return the measure f of eigenvalues `values`, and g with `df = Re(g d value)`."""
        poles, rate = values, np.ones_like(values)
        if self.transformed:
            half = 0.5 * self.dt
            poles, rate = (1.0 + half * values) / (1.0 - half * values), 2.0 * half / (1.0 - half * values) ** 2
        size = np.maximum(np.abs(poles), 1e-300)
        if self.size:
            return np.abs(poles), poles.conj() / size * rate
        if self.dt:
            return np.log(size) / self.dt, poles.conj() / size**2 * rate / self.dt
        return poles.real, rate

    def largest(self, A: Matrix) -> float:
        """Return the largest measure of an eigenvalue; infinite if `A` is not finite."""
        if not np.all(np.isfinite(A)):
            return np.inf
        return float(np.max(self.of(eigenvalues(A))[0], initial=-np.inf))


def pole_slopes(A: Matrix, B2: Matrix, C2: Matrix, measure: PoleMeasure, near: float) -> list[BranchSlope]:
    """Return a branch for each eigenvalue of A with a measure within `near` of the largest."""
    values, right = np.linalg.eig(A)
    if np.linalg.cond(right) > 1e12:  # a defective eigenvalue has no derivative
        return []
    left = np.linalg.inv(right)
    found, rate = measure.of(values.astype(np.complex128))
    slopes = [
        BranchSlope(float(found[k]), (rate[k] * np.outer(left[k] @ B2, C2 @ right[:, k])).real)
        for k in np.nonzero((found >= np.max(found) - near) & (values.imag >= 0.0))[0]
    ]
    return sorted(slopes, key=lambda slope: -slope.value)


def loop_peak(loop: ClosedLoop, warm: list[float]) -> Peak:
    """Return the H-infinity norm of a loop, starting from the frequencies `warm` [rad/s] and its resonances.

    A lower bound is raised to the gain in the middle of the bands given by a Hamiltonian matrix. A search calls it
    thousands of times on similar loops, so the first guess is nearly always the peak. Rounding hides peaks of a stiff
    loop from the matrix: `robust.lti.norms.hinf_norm` samples the gain first, and the search's results are checked by
    it.
    """
    if not np.isfinite(loop.A).all():
        return Peak(gain=np.inf, omega=0.0)
    poles = eigenvalues(loop.A)
    size = np.abs(poles)
    if not poles.real.max() < -_ROUNDING * size.max():
        return Peak(gain=np.inf, omega=0.0)
    best = Peak(gain=_feedthrough(loop), omega=np.inf)
    upper = poles.imag >= 0.0
    squares = poles.imag[upper] ** 2 - poles.real[upper] ** 2
    best = _raise_bound(loop, best, np.concatenate([[0.0], warm, size[upper], np.sqrt(squares[squares > 0.0])]))
    for _ in range(_ROUNDS if best.gain > 0.0 else 0):
        ends = crossings(loop, (1.0 + _ACCURACY) * best.gain)
        if ends.size == 0:
            break
        ends = np.concatenate([[0.0], ends, [2.0 * ends[-1]]])
        higher = _raise_bound(
            loop, best, np.concatenate([0.5 * (ends[:-1] + ends[1:]), np.sqrt(ends[1:-1] * ends[2:])])
        )
        if higher.gain <= (1.0 + _ACCURACY) * best.gain:
            return higher
        best = higher
    return best


def peak_slopes(loop: ClosedLoop, top: Peak, near: float) -> list[BranchSlope]:
    """Return a branch for each singular value, at each local peak, within the fraction `near` of the norm `top`."""
    frequencies = [top.omega]
    if near > 0.0:
        frequencies += [
            omega for omega in _local_peaks(loop, (1.0 - near) * top.gain) if _is_distinct(omega, top.omega)
        ]
    slopes = []
    for omega in frequencies:
        G, left, right = _transfers(loop, omega)
        U, sizes, Vh = np.linalg.svd(G)
        for k, size in enumerate(sizes if near > 0.0 else sizes[:1]):
            if near == 0.0 or size >= (1.0 - near) * top.gain:
                row, column = U[:, k].conj() @ left, right @ Vh[k].conj()
                slopes.append(BranchSlope(float(size), np.outer(row, column).real))
    return sorted(slopes, key=lambda slope: -slope.value)


def loop_h2_norm(loop: ClosedLoop) -> float:
    """Return the H2 norm; infinite for an unstable loop or one with feedthrough."""
    if not abscissa(loop.A) < -_ROUNDING * np.linalg.norm(loop.A) or np.max(
        np.abs(loop.D), initial=0.0
    ) > 1e-12 * np.max(np.abs(loop.C), initial=1.0):
        return np.inf
    X = scipy.linalg.solve_continuous_lyapunov(loop.A, -loop.B @ loop.B.T)
    return float(np.sqrt(max(np.trace(loop.C @ X @ loop.C.T), 0.0)))


def h2_slope(loop: ClosedLoop) -> BranchSlope:
    """Return the H2 norm of a stable loop without feedthrough, and its gradient."""
    X = scipy.linalg.solve_continuous_lyapunov(loop.A, -loop.B @ loop.B.T)
    Y = scipy.linalg.solve_continuous_lyapunov(loop.A.T, -loop.C.T @ loop.C)
    value = float(np.sqrt(max(np.trace(loop.C @ X @ loop.C.T), 0.0)))
    by_A, by_B, by_C = Y @ X, Y @ loop.B, loop.C @ X
    gradient = loop.B2.T @ (by_A @ loop.C2.T + by_B @ loop.D21.T) + loop.D12.T @ by_C @ loop.C2.T
    return BranchSlope(value, gradient / max(value, 1e-300))


def crossings(loop: ClosedLoop, level: float) -> Matrix:
    """Return the frequencies >= 0, ascending, where a singular value may equal `level` (> sigma_max(D))."""
    A, B, C, D = loop[:4]
    if D.any():
        R = level**2 * np.eye(D.shape[1]) - D.T @ D
        S = level**2 * np.eye(D.shape[0]) - D @ D.T
        A = A + B @ np.linalg.solve(R, D.T @ C)
        Q, N = level * B @ np.linalg.solve(R, B.T), level * C.T @ np.linalg.solve(S, C)
    else:
        Q, N = B @ B.T / level, C.T @ C / level
    n = A.shape[0]
    H = np.empty((2 * n, 2 * n))
    H[:n, :n], H[:n, n:], H[n:, :n], H[n:, n:] = A, Q, -N, -A.T
    values = eigenvalues(H)
    size = np.abs(values)
    on_axis = np.abs(values.real) <= _ON_AXIS * size + 1e-13 * size.max()
    return np.sort(values.imag[on_axis & (values.imag >= 0.0)])


def _feedthrough(loop: ClosedLoop) -> float:
    """Return the gain at infinite frequency."""
    return float(np.linalg.norm(loop.D, 2)) if loop.D.any() else 0.0


def _raise_bound(loop: ClosedLoop, best: Peak, omega: Matrix) -> Peak:
    gains = _gains(loop, omega)
    k = gains.argmax()
    return Peak(gain=float(gains[k]), omega=float(omega[k])) if gains[k] > best.gain else best


def _is_distinct(omega: float, other: float) -> bool:
    return abs(omega - other) > 1e-3 * omega


def _local_peaks(loop: ClosedLoop, level: float) -> list[float]:
    """Return the frequency of the largest gain, to some digits, in each band where the gain exceeds `level`."""
    if _feedthrough(loop) >= level:
        return []
    ends, found = np.concatenate([[0.0], crossings(loop, level)]), []
    for low, high in pairwise(ends):
        if high - low <= 1e-6 * high:
            continue
        for _ in range(3):
            omega = np.linspace(low, high, 9)
            k = int(np.argmax(_gains(loop, omega)))
            if k in (0, 8):  # the gain is higher outside the band: no separate peak
                break
            low, high = omega[k - 1], omega[k + 1]
        else:
            found.append(float(omega[k]))
    return found


def _gains(loop: ClosedLoop, omega: Matrix) -> Matrix:
    """Return the largest singular value at each frequency `omega` [rad/s]."""
    n = len(loop.A)
    pencil = np.empty((omega.size, n, n), dtype=np.complex128)
    pencil[:] = -loop.A
    pencil.reshape(omega.size, -1).imag[:, :: n + 1] = omega[:, None]
    response = loop.C @ np.linalg.solve(pencil, loop.B[None].astype(np.complex128)) + loop.D
    return np.asarray(np.linalg.svd(response, compute_uv=False)[:, 0])


def _transfers(loop: ClosedLoop, omega: float) -> tuple[ComplexMatrix, ComplexMatrix, ComplexMatrix]:
    """Return the loop's response at `omega`, and the left and right factors of dM in its derivative."""
    if math.isinf(omega):
        return _as_complex(loop.D), _as_complex(loop.D12), _as_complex(loop.D21)
    pencil = 1j * omega * np.eye(loop.A.shape[0]) - loop.A
    right, left = np.linalg.solve(pencil, _as_complex(loop.B)), np.linalg.solve(pencil.T, _as_complex(loop.C.T)).T
    return _as_complex(loop.C @ right + loop.D), left @ loop.B2 + loop.D12, _as_complex(loop.C2 @ right + loop.D21)


def _as_complex(matrix: ArrayLike) -> ComplexMatrix:
    return np.asarray(matrix, dtype=np.complex128)
