"""Upper bounds on mu and the worst-case gain of a complex matrix by D-G scalings, and their frequency bands.

An interior-point search finds the scalings, but no bound rests on it: `Scalings.level` computes the bound from the
scalings alone, by eigenvalues.
"""

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from gustproof.robust.lti.balancing import balancing_units
from gustproof.robust.lti.state_space import ComplexMatrix, Lti, Matrix
from gustproof.robust.uncertain.uncertainty import DeltaBlock, RealBlock, columns, rows
from gustproof.robust.uncertain.units import channel_units

_WEIGHT_FACTOR = 8.0
"""Factor on the weight of the objective from one centre to the next."""
_NEWTON_STEPS = 12
"""Most Newton steps for a centre; unbounded scalings have no centre, and the search goes on."""
_BAND_OVERLAP = 1e-6
"""[-] relative amount by which bands are shortened: neighbours then overlap, and rounding leaves no gap."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scalings:
    """Multipliers that bound mu: `M* D_z M + j (G M - M* G*) <= beta^2 D_w`, all commuting with Delta.

    For a gain, beta multiplies the last block alone, the performance channel, and Delta of the others stays in the unit
    ball. Then beta bounds the worst-case gain.
    """

    D_z: ComplexMatrix
    """(n_z, n_z) positive definite, on the inputs of Delta."""
    D_w: ComplexMatrix
    """(n_w, n_w) the same scalings on the outputs of Delta."""
    G: ComplexMatrix
    """(n_w, n_z) Hermitian on real blocks, 0 elsewhere."""
    gain: ComplexMatrix
    """(n_w, n_w) part of `D_w` that beta^2 multiplies: all of it for mu, the last block's for the gain."""

    def form(self, M: ComplexMatrix) -> ComplexMatrix:
        """Return `M* D_z M + j (G M - M* G*) - (D_w - gain)`, which must stay below beta^2 `gain`."""
        turned = 1j * self.G @ M
        return np.asarray(M.conj().T @ self.D_z @ M + turned + turned.conj().T - (self.D_w - self.gain))

    def level(self, M: ComplexMatrix) -> float:
        """Return the least beta that these scalings prove for `M`; infinite if they prove none."""
        if min(self.D_z.diagonal().real.min(), self.D_w.diagonal().real.min()) <= 0.0:
            return np.inf
        z, w = self._sizes()
        own, M = self.in_units(1.0 / z, 1.0 / w), M * z[:, None] / w
        n = own.gain.shape[0]
        counts = np.diag(own.gain).real != 0.0
        on, off = np.flatnonzero(counts), np.flatnonzero(~counts)
        # rounding of the form counts against the bound: with huge G, little is proved
        size = np.abs(M)
        terms = np.linalg.norm(np.abs(own.G) @ size) + np.linalg.norm(size.T @ np.abs(own.D_z) @ size)
        form = own.form(M) + 1e-14 * n * terms * np.eye(n)
        rest = -form[np.ix_(off, off)]
        inner = form[np.ix_(on, on)]
        if off.size:
            if np.linalg.eigvalsh(rest)[0] <= 0.0:
                return np.inf
            inner = inner + form[np.ix_(on, off)] @ np.linalg.solve(rest, form[np.ix_(off, on)])
        largest = scipy.linalg.eigvalsh(_hermitian_part(inner), own.gain[np.ix_(on, on)])[-1]
        return float(np.sqrt(max(largest, 0.0)))

    def _sizes(self) -> tuple[Matrix, Matrix]:
        """Return the sizes of z (n_z,) and w (n_w,) in the units in which D has the diagonal 1.

        They do not depend on the units of the channels, and neither does a sum of terms in them.
        """
        return np.sqrt(self.D_z.diagonal().real), np.sqrt(self.D_w.diagonal().real)

    def in_units(self, z: Matrix, w: Matrix) -> "Scalings":
        """Return these scalings for the channels in units z and w, in which `M` is `M w / z`."""
        return Scalings(
            D_z=self.D_z * np.outer(z, z),
            D_w=self.D_w * np.outer(w, w),
            G=self.G * np.outer(w, z),
            gain=self.gain * np.outer(w, w),
        )

    def band(self, M: Lti, level: float, omega: float) -> tuple[float, float]:
        """Return the band around `omega` [rad/s] on which the scalings prove `level` for the continuous `M`.

        The form is singular only where a pencil of order 2n + m has an eigenvalue on the imaginary axis. The band holds
        between frequencies, up to rounding. It is empty, `(omega, omega)`, if the level is not proved at `omega`.
        """
        if not self.level(M.response(omega)[0]) < level:
            return (omega, omega)
        pencil, mass = self._pencil(M, level)
        alpha, beta = scipy.linalg.eig(pencil, mass, right=False, homogeneous_eigvals=True)
        finite = np.abs(beta) > 1e-13 * np.abs(alpha)
        poles = alpha[finite] / beta[finite]
        near = np.abs(poles.real) <= 1e-6 * np.abs(poles) + 1e-12 * np.max(np.abs(M.A), initial=1.0)
        crossings = poles[near].imag
        below, above = crossings[crossings < omega], crossings[crossings > omega]
        low, high = max(float(np.max(below, initial=0.0)), 0.0), float(np.min(above, initial=np.inf))
        # rounding may lose a crossing if scalings are extreme: the band ends at a sample that contradicts it
        speeds = np.array([omega]) if omega > 0.0 else np.append(np.abs(M.poles()), 1.0)
        inside = np.geomspace(max(low, 1e-3 * np.min(speeds)), min(high, 1e3 * np.max(speeds)), 40)
        inside = inside[(low < inside) & (inside < high)]
        denied = inside[~self._are_proven(M.response(inside), 1.001 * level)]
        low = float(np.max(denied[denied < omega], initial=low))
        high = float(np.min(denied[denied > omega], initial=high))
        return (min((1.0 + _BAND_OVERLAP) * low, omega), max((1.0 - _BAND_OVERLAP) * high, omega))

    def _pencil(self, M: Lti, level: float) -> tuple[ComplexMatrix, Matrix]:
        """Return the balanced pencil of the form at a level, and its mass: singular where the form is."""
        z, w = self._sizes()
        own, n, m = self.in_units(1.0 / z, 1.0 / w), M.order, M.n_inputs
        B, C, D = M.B / w, M.C * z[:, None], M.D * z[:, None] / w
        DC, DD = own.D_z @ C, own.D_z @ D
        turned = 1j * own.G
        Q, S = C.T @ DC, C.T @ (DD + turned.conj().T)
        R = D.T @ DD + turned @ D + (turned @ D).conj().T - (own.D_w - own.gain) - level**2 * own.gain
        pencil = np.block([[M.A, np.zeros((n, n)), B], [-Q, -M.A.T, -S], [S.conj().T, B.T, R]])
        signals = [slice(k, k + 1) for k in range(2 * n + m)]
        units = balancing_units(pencil, signals, signals)
        mass = scipy.linalg.block_diag(np.eye(2 * n), np.zeros((m, m)))
        return np.asarray(pencil * units / units[:, None]), mass

    def _are_proven(self, responses: ComplexMatrix, level: float) -> NDArray[np.bool_]:
        """Return (k,) whether the level of each response (k, n_z, n_w) is at most `level`."""
        if min(self.D_z.diagonal().real.min(), self.D_w.diagonal().real.min()) <= 0.0:
            return np.zeros(len(responses), dtype=bool)
        z, w = self._sizes()
        own, M = self.in_units(1.0 / z, 1.0 / w), responses * z[:, None] / w
        size, one = np.abs(M), np.eye(w.size)
        squares = size.transpose(0, 2, 1) @ np.abs(own.D_z) @ size
        terms = np.linalg.norm(np.abs(own.G) @ size, axis=(1, 2)) + np.linalg.norm(squares, axis=(1, 2))
        turned = 1j * own.G @ M
        form = _adjoint(M) @ own.D_z @ M + turned + _adjoint(turned) - (own.D_w - own.gain)
        slack = level**2 * own.gain - form - 1e-14 * w.size * terms[:, None, None] * one
        return np.asarray(np.linalg.eigvalsh(0.5 * (slack + _adjoint(slack)))[:, 0] >= 0.0)


class _Basis(NamedTuple):
    """Basis of the scalings: N directions, stacked."""

    D_z: ComplexMatrix
    D_w: ComplexMatrix
    G: ComplexMatrix
    gain: ComplexMatrix

    def combine(self, x: Matrix) -> Scalings:
        return Scalings(**{name: np.tensordot(x, getattr(self, name), 1) for name in self._fields})


def best_scalings(
    M: ComplexMatrix,
    blocks: tuple[DeltaBlock, ...],
    *,
    gain: bool,
    accuracy: float = 1e-3,
    enough: float = 0.0,
    real: bool = True,
) -> Scalings:
    """Return scalings whose level for the matrix `M` is within `accuracy` of the least one of D-G scalings.

    The matrix is balanced first: units of channels do not matter. The least level is a generalised eigenvalue problem,
    solved as a few convex ones (Dinkelbach), each by a barrier method with Newton steps. Cost: some 50 Newton steps of
    N matrices (n, n), N the number of free scalings.

    Parameters
    ----------
    M
        (n_z, n_w) closed by Delta.
    blocks
        Blocks of Delta; with `gain` the last one is the performance channel.
    gain
        True to bound the gain of the last block over the unit ball of the others, instead of mu.
    accuracy
        [-] relative.
    enough
        [-] level at which the search may stop at once.
    real
        True to exploit that parameters are real. Where mu of real parameters jumps with frequency, only scalings with
        G = 0 hold on a band.

    References
    ----------
    M. K. H. Fan, A. L. Tits, J. C. Doyle, Robustness in the presence of mixed parametric uncertainty and unmodeled
    dynamics, IEEE TAC 36 (1991), 25-38. W. Dinkelbach, On nonlinear fractional programming, Management Science 13
    (1967), 492-498.
    """
    units = channel_units(M[None], blocks[:-1] if gain else blocks)
    output = units.output if gain else 1.0
    z, w = units.all_z(M.shape[0], output), units.all_w(M.shape[1])
    found = _search(M * w / z[:, None], blocks, gain=gain, accuracy=accuracy, enough=enough / output, real=real)
    w[units.w.size :] = output  # what performance reads and drives has one scaling
    return found.in_units(1.0 / z, 1.0 / w)


def _search(
    M: ComplexMatrix, blocks: tuple[DeltaBlock, ...], *, gain: bool, accuracy: float, enough: float, real: bool
) -> Scalings:
    """Return the scalings of `best_scalings` for a balanced matrix."""
    basis = _basis(blocks, gain, real)
    best = _initial_scalings(M, blocks, gain, real)
    level = best.level(M)
    # no gain is below the one at Delta = 0, but mu may be 0
    floor = enough if gain else max(accuracy * float(np.linalg.norm(M, 2)), enough)
    while floor < level < np.inf:
        try:
            found = _improve(basis, best, M, level, accuracy, enough)
        except np.linalg.LinAlgError:
            break  # rounding dominates: the bound is that of the scalings before
        reached = found.level(M)
        if not reached < level:
            break
        best, previous, level = found, level, reached
        if level > (1.0 - 0.5 * accuracy) * previous:
            break
    # where mu is 0, G may grow without bound; keep no more than needed, so that rounding does not destroy bands
    while level < floor and (smaller := replace(best, G=0.5 * best.G)).level(M) < floor:
        if not np.any(smaller.G):
            break
        best = smaller
    return best


def _basis(blocks: tuple[DeltaBlock, ...], gain: bool, real: bool) -> _Basis:
    z_parts, w_parts = columns(blocks), rows(blocks)
    n_z, n_w = z_parts[-1].stop, w_parts[-1].stop
    D_z, D_w, G, level = [], [], [], []
    for k, (block, z, w) in enumerate(zip(blocks, z_parts, w_parts, strict=True)):
        is_real = isinstance(block, RealBlock)
        counts = gain <= (k == len(blocks) - 1)
        shapes = _hermitian_basis(block.shape[0]) if is_real or block.repeats > 1 else []
        whole = [(np.eye(block.shape[1]), np.eye(block.shape[0]))]
        for read, drive in [(shape, shape) for shape in shapes] or whole:
            D_z.append(_embed(read, z, z, n_z, n_z))
            D_w.append(_embed(drive, w, w, n_w, n_w))
            G.append(np.zeros((n_w, n_z), dtype=np.complex128))
            level.append(D_w[-1] * counts)
        for shape in shapes if real and is_real else []:
            D_z.append(np.zeros((n_z, n_z), dtype=np.complex128))
            D_w.append(np.zeros((n_w, n_w), dtype=np.complex128))
            G.append(_embed(shape, w, z, n_w, n_z))
            level.append(D_w[-1])
    return _Basis(D_z=np.array(D_z), D_w=np.array(D_w), G=np.array(G), gain=np.array(level))


def _hermitian_basis(r: int) -> list[ComplexMatrix]:
    units = np.eye(r, dtype=np.complex128)
    found = [np.outer(units[k], units[k]) for k in range(r)]
    for k in range(r):
        for j in range(k):
            pair = np.outer(units[k], units[j])
            found += [pair + pair.T, 1j * (pair - pair.T)]
    return found


def _embed(part: ComplexMatrix | Matrix, i: slice, j: slice, n: int, m: int) -> ComplexMatrix:
    whole = np.zeros((n, m), dtype=np.complex128)
    whole[i, j] = part
    return whole


def _initial_scalings(M: ComplexMatrix, blocks: tuple[DeltaBlock, ...], gain: bool, real: bool) -> Scalings:
    """Return initial scalings: balanced; for the gain, scalings that prove the other blocks stable, if any do."""
    if not gain or len(blocks) == 1:
        return _diagonal_scalings(blocks, _balance(M, blocks), gain)
    z, w = columns(blocks)[-1].start, rows(blocks)[-1].start
    inner = _search(M[:z, :w], blocks[:-1], gain=False, accuracy=0.02, enough=0.9, real=real)
    start = _diagonal_scalings(blocks, np.ones(len(blocks)), gain)
    slack = inner.gain - inner.form(M[:z, :w])
    if np.linalg.eigvalsh(slack)[0] <= 0.0:
        return start
    # half the weight of the performance channel that would use all slack of the other blocks
    seen = scipy.linalg.eigvalsh(M[z:, :w].conj().T @ M[z:, :w], slack)[-1]
    weight = 0.5 / max(float(seen), 1e-12)
    return Scalings(
        D_z=scipy.linalg.block_diag(inner.D_z, weight * start.D_z[z:, z:]),
        D_w=scipy.linalg.block_diag(inner.D_w, weight * start.D_w[w:, w:]),
        G=_embed(inner.G, slice(0, w), slice(0, z), *start.G.shape),
        gain=weight * start.gain,
    )


def _diagonal_scalings(blocks: tuple[DeltaBlock, ...], weights: Matrix, gain: bool) -> Scalings:
    sizes_w, sizes_z = [block.shape[0] for block in blocks], [block.shape[1] for block in blocks]
    D_z, D_w = np.diag(np.repeat(weights, sizes_z)), np.diag(np.repeat(weights, sizes_w))
    counted = D_w.copy()
    if gain:
        counted[: -sizes_w[-1], : -sizes_w[-1]] = 0.0
    zero = np.zeros((D_w.shape[0], D_z.shape[0]), dtype=np.complex128)
    return Scalings(D_z=D_z.astype(complex), D_w=D_w.astype(complex), G=zero, gain=counted.astype(complex))


def _balance(M: ComplexMatrix, blocks: tuple[DeltaBlock, ...]) -> Matrix:
    """Return one weight per block that makes its input and output equally large (Osborne)."""
    size = np.array([[np.linalg.norm(M[z, w]) ** 2 for w in rows(blocks)] for z in columns(blocks)])
    np.fill_diagonal(size, 0.0)
    floor = 1e-12 * max(float(np.max(size)), np.finfo(float).tiny)
    weights = np.ones(len(blocks))
    for _ in range(20):
        for k in range(len(blocks)):
            row, column = size[k] @ (1.0 / weights), weights @ size[:, k]
            weights[k] = np.sqrt((column + floor) / (row + floor))
    return np.asarray(np.clip(weights / weights[-1], 1e-10, 1e10))


def _improve(
    basis: _Basis, start: Scalings, M: ComplexMatrix, level: float, accuracy: float, enough: float
) -> Scalings:
    """Return scalings with the least s in `form <= level^2 gain + s R`, R the gain part of `start`.

    Barrier method: follow the centres of `t s - log det F - log det D_w` for growing t, F the slack of the inequality.
    """
    congruent = M.conj().T @ basis.D_z @ M
    turned = 1j * basis.G @ M
    slack = level**2 * basis.gain - congruent - turned - _adjoint(turned) + basis.D_w - basis.gain
    # scalings of one inequality are defined up to a factor: keep the trace of D_w
    trace = np.trace(basis.D_w, axis1=1, axis2=2).real
    free = np.asarray(scipy.linalg.null_space(trace[None]))
    barriers = [
        np.concatenate([np.tensordot(free.T, slack, 1), start.gain[None]]),
        np.concatenate([np.tensordot(free.T, basis.D_w, 1), np.zeros((1, *start.D_w.shape))]),
    ]
    origin = _coordinates(basis, start)
    offsets = [np.tensordot(origin, slack, 1), np.tensordot(origin, basis.D_w, 1)]
    y = np.zeros(free.shape[1] + 1)
    y[-1] = 0.05 * level**2
    weight = len(start.D_w) / level**2
    while weight < 4.0 * len(start.D_w) / (accuracy * level**2):
        y = _centre(y, weight, offsets, barriers)
        weight *= _WEIGHT_FACTOR
        found = basis.combine(origin + free @ y[:-1])
        if found.level(M) <= enough:
            break
    return basis.combine(origin + free @ y[:-1])


def _centre(y: Matrix, weight: float, offsets: list[ComplexMatrix], barriers: list[ComplexMatrix]) -> Matrix:
    """Return the minimiser of `weight y[-1] - sum log det (offset + y . barrier)`, by damped Newton steps."""
    roots = _roots(y, offsets, barriers)
    for _ in range(_NEWTON_STEPS):
        gradient, hessian = np.zeros(y.size), np.zeros((y.size, y.size))
        gradient[-1] = weight
        for root, barrier in zip(map(np.linalg.inv, roots), barriers, strict=True):
            scaled = np.asarray(root @ barrier @ root.conj().T).reshape(y.size, -1)
            gradient -= scaled[:, :: root.shape[0] + 1].real.sum(axis=1)
            parts = scaled.view(np.float64)  # real and imaginary ones in turn
            hessian += parts @ parts.T
        # a scaling without effect on a real response has neither curvature nor gradient
        diagonal = np.sqrt(np.maximum(hessian.diagonal(), 1e-30 * np.max(hessian)))
        normed = hessian / np.outer(diagonal, diagonal) + 1e-12 * np.eye(y.size)
        _, solved, failed = scipy.linalg.lapack.dposv(normed, gradient / diagonal)
        if failed:
            raise np.linalg.LinAlgError("the Hessian matrix is not positive definite")
        step = -solved / diagonal
        decrement = math.sqrt(max(-float(gradient @ step), 0.0))
        length = 1.0 / (1.0 + decrement) if decrement > 0.25 else 1.0
        inside = _move_inside(y, length, step, offsets, barriers)
        if inside is None:
            break
        y, roots = inside
        if decrement < 0.1:
            break
    return y


def _roots(y: Matrix, offsets: list[ComplexMatrix], barriers: list[ComplexMatrix]) -> list[ComplexMatrix]:
    """Return Cholesky's factors of `offset + y . barrier`; raises `LinAlgError` outside the barriers."""
    points = [
        offset + np.dot(y[None], barrier.reshape(y.size, -1)).reshape(offset.shape)
        for offset, barrier in zip(offsets, barriers, strict=True)
    ]
    return [np.asarray(np.linalg.cholesky(_hermitian_part(point)), dtype=complex) for point in points]


def _move_inside(
    y: Matrix, length: float, step: Matrix, offsets: list[ComplexMatrix], barriers: list[ComplexMatrix]
) -> tuple[Matrix, list[ComplexMatrix]] | None:
    """Return `y` moved by `length` of `step`, halved until it is inside the barriers, and its factors there."""
    while length > 1e-6:
        near = y + length * step
        with suppress(np.linalg.LinAlgError):
            return near, _roots(near, offsets, barriers)
        length *= 0.5
    return None


def _coordinates(basis: _Basis, scalings: Scalings) -> Matrix:
    """Return the coordinates of scalings in a basis of orthogonal directions."""
    projections = np.zeros(len(basis.D_w))
    for directions, value in ((basis.D_w, scalings.D_w), (basis.G, scalings.G)):
        size = np.sum(np.abs(directions) ** 2, axis=(1, 2))
        inner = np.sum((directions.conj() * value).real, axis=(1, 2))
        projections += np.divide(inner, size, out=np.zeros_like(size), where=size > 0.0)
    return projections


def _hermitian_part(matrix: ComplexMatrix) -> ComplexMatrix:
    return np.asarray(0.5 * (matrix + matrix.conj().T))


def _adjoint(stack: ComplexMatrix) -> ComplexMatrix:
    return np.asarray(stack.conj().transpose(0, 2, 1))
