"""H-infinity and H2 norms of linear systems, continuous and discrete."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from scipy.linalg.lapack import dgeev, dtrsyl

from gustproof.errors import DesignError
from gustproof.robust.lti.balancing import balance_states, balanced_realization, gramian_factor
from gustproof.robust.lti.bilinear import bilinear_transform
from gustproof.robust.lti.gain_curve import GainCurve, gain_curve
from gustproof.robust.lti.state_space import ComplexMatrix, LinearSystem, Lti, Matrix, as_lti, largest_gain
from gustproof.types import Array

_AXIS_TOLERANCE = 1e-6
"""[-] eigenvalues with a real part below this fraction of their magnitude, or below rounding, count as crossings."""

_LEVEL_EXCESSES = (1e-4, 1e-6, 1e-8)
"""[-] relative excess over the gain at infinity of the levels tried first, while no larger gain is known. Closer to
that gain the Hamiltonian matrix grows without bound, and its rounding hides crossings."""


_SEEN_BELOW = (1e-8, 1e-6, 1e-4, 1e-2, 0.1, 0.5)
"""[-] relative distances below the largest gain known at which the Hamiltonian matrix is asked whether it sees that
peak. What it does not see there, it may miss elsewhere."""

_LOOKS = 2
"""Number of looks at the Hamiltonian matrix that may settle a norm before it is searched in rounds."""

_NARROW, _FAR_BELOW = 1e-2, 1e-4
"""[-] largest width of a narrow band, of the distance of the samples about it, and how far below these are. A parabola
is a hundred times as wide there."""

_BALANCINGS, _GAIN_BITS, _SPEED_BITS = 40, 10, 200
"""Times that states and gain are balanced in turn at most. Bits by which B C may exceed the square of A, and of a speed
in rad/s."""

_NOISE = 1e-2
"""[-] part of a gain from which its rounding may hide every crossing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Peak:
    """Largest gain of a system over all frequencies, and its frequency."""

    gain: float
    """[-] largest singular value; infinite for an unstable system."""
    omega: float
    """[rad/s] frequency of the peak; infinite if the gain only tends to it."""
    error: float = math.inf
    """[-] the norm differs from `gain` by at most this, search and rounding together; infinite if that is not known."""


def hinf_norm(system: LinearSystem, *, accuracy: float = 1e-9) -> Peak:
    """Return the H-infinity norm, its frequency and its error.

    The gain is sampled on and beside the poles' frequencies and on a grid over their range, and its highest tops are
    climbed. The eigenvalues of a Hamiltonian matrix then give the frequency bands in which the gain exceeds a level.
    One narrow band about the peak, at a level 1e-8 below it, settles the norm. Else the lower bound is raised to the
    gain at the middle of the bands until none is left; convergence is quadratic. A discrete system is mapped by the
    bilinear transformation, which keeps the norm. An unstable system has an infinite norm.

    Rounding may hide bands. So the matrix must see the peak that was found, at a level just below it. If it does not,
    it is formed again in coordinates balanced by Gramians. The `error` of the result is 2 `accuracy` times the gain,
    and the rounding of the response at the peak. Where neither matrix sees the peak at 1e-8 below it, the error is at
    least the distance at which one does. Cost: one to four eigenvalue problems of order 2n.

    Raises
    ------
    ValueError
        If `accuracy` is not between 0 and 1.
    DesignError
        If 60 rounds did not suffice (rounding dominates: the system is badly scaled).

    References
    ----------
    N. A. Bruinsma, M. Steinbuch, A fast algorithm to compute the H-infinity-norm of a transfer function matrix,
    Systems & Control Letters 14 (1990), 287-293.

    Examples
    --------
    >>> from control import ss
    >>> from gustproof import hinf_norm
    >>> peak = hinf_norm(ss([[0.0, 1.0], [-1.0, -0.2]], [[0.0], [1.0]], [[1.0, 0.0]], 0.0))
    >>> f"{peak.gain:.3f} at {peak.omega:.3f} rad/s"
    '5.025 at 0.990 rad/s'
    """
    if not 0.0 < accuracy < 1.0:
        raise ValueError(f"accuracy is {accuracy!r}, must be between 0 and 1")
    G = balance_states(as_lti(system))
    poles, modes = _eigensystem(G.A)
    beyond = np.abs(poles) - 1.0 if G.dt else poles.real
    if beyond.max(initial=-1.0) >= 0.0:
        worst = poles[np.argmax(beyond)]
        omega = float(abs(np.angle(worst)) / G.dt if G.dt else abs(worst.imag))
        return Peak(gain=np.inf, omega=omega, error=0.0)
    if not G.order or not G.D.size:
        size = largest_gain(G.D) if G.D.size else 0.0
        return Peak(gain=size, omega=np.inf, error=2.0 * accuracy * size)
    peak = _stable_peak(gain_curve(G, poles, modes), accuracy)
    if G.dt:
        omega = 2.0 / G.dt * math.atan(peak.omega * G.dt / 2.0)
        return Peak(gain=peak.gain, omega=omega, error=peak.error)
    return peak


def eigenvalues(A: Matrix) -> ComplexMatrix:
    """Return the eigenvalues of a small real matrix; numpy's own function takes twice as long.

    Raises
    ------
    ValueError
        If `A` is not finite.
    LinAlgError
        If they did not converge.
    """
    return _decompose(A, with_vectors=False)[0]


def _eigensystem(A: Matrix) -> tuple[ComplexMatrix, ComplexMatrix]:
    """Return the eigenvalues (n,) and eigenvectors (n, n) of a small real matrix."""
    values, packed = _decompose(A, with_vectors=True)
    vectors = packed.astype(np.complex128)
    (first,) = np.nonzero(values.imag > 0.0)  # its real and imaginary part stand side by side
    vectors[:, first] += 1j * packed[:, first + 1]
    vectors[:, first + 1] = vectors[:, first].conj()
    return values, vectors


def _decompose(A: Matrix, *, with_vectors: bool) -> tuple[ComplexMatrix, Matrix]:
    """Return eigenvalues, and eigenvectors as LAPACK packs them, if they are asked for."""
    if not A.size:
        return np.zeros(0, dtype=np.complex128), A
    if not np.isfinite(A).all():
        raise ValueError("the matrix has what is no number or infinite")
    real, imaginary, _, vectors, failed = dgeev(A, compute_vl=0, compute_vr=with_vectors)
    if failed:
        raise np.linalg.LinAlgError("the eigenvalues did not converge")
    return np.asarray(real + 1j * imaginary), np.asarray(vectors)


def h2_norm(system: LinearSystem) -> float:
    """Return the H2 norm: rms output for white noise of unit density (continuous) or unit variance a sample (discrete).

    Infinite for an unstable system, and for a continuous one with feedthrough. Units of the states do not matter.

    References
    ----------
    K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control, Prentice Hall 1996, Lemma 4.6.

    Examples
    --------
    >>> from control import ss
    >>> from gustproof import h2_norm
    >>> round(h2_norm(ss(-2.0, 2.0, 1.0, 0.0)), 6)
    1.0
    """
    G = as_lti(system)
    if not G.order:
        return float("inf") if not G.dt and np.any(G.D) else float(np.linalg.norm(G.D))
    G, size = _balance_gain(G)
    if G.dt:
        if not G.is_stable():
            return float("inf")
        gramian = scipy.linalg.solve_discrete_lyapunov(G.A, G.B @ G.B.T)
        return size * float(np.sqrt(max(np.trace(G.C @ gramian @ G.C.T) + np.sum(G.D**2), 0.0)))
    # One Schur form gives poles and Gramian; its diagonal has their real parts.
    T, U = scipy.linalg.schur(G.A)
    if np.any(G.D) or T.diagonal().max() >= 0.0:
        return float("inf")
    B, C = U.T @ G.B, G.C @ U
    gramian, scale, perturbed = dtrsyl(T, T, -B @ B.T, tranb="T")
    if perturbed:  # it took two poles for mirror images of each other and moved them: the Gramian is of other poles
        return size * float(np.linalg.norm(G.C @ gramian_factor(G.A, G.B, G.dt)))
    return size * float(np.sqrt(max(np.trace(C @ gramian @ C.T) / scale, 0.0)))


def _balance_gain(G: Lti) -> tuple[Lti, float]:
    """Return a system with balanced states, divided by a power of two that makes B C like A A, and that power.

    A large gain would otherwise unbalance the states: units that make B and C alike large spoil A. Of a speed whose
    square has no number, a continuous system has another unit of time.
    """
    if _has_usual_gain(balanced := balance_states(G)):
        return balanced, 1.0
    size, speed = 1.0, float(np.max(np.abs(np.linalg.eigvals(G.A))))
    if not G.dt and speed and abs(math.log2(speed)) > _SPEED_BITS:
        size = 2.0 ** round(0.5 * math.log2(speed))
        G, speed = Lti(A=G.A / size / size, B=G.B / size, C=G.C / size, D=G.D), speed / size / size
    for _ in range(_BALANCINGS):
        G = balance_states(G)
        b, c = (float(np.max(np.abs(part), initial=0.0)) for part in (G.B, G.C))
        over = math.log2(b) + math.log2(c) - 2.0 * math.log2(speed) if b and c and speed else 0.0
        if -20 * _GAIN_BITS < over < _GAIN_BITS:
            break
        half = 2.0 ** round(0.25 * over)
        G, size = Lti(A=G.A, B=G.B / half, C=G.C / half, D=G.D / half**2, dt=G.dt), size * half**2
    return G, size


def _has_usual_gain(G: Lti) -> bool:
    """Return whether a balanced system certainly needs no other gain: by bounds of its speed, without its poles."""
    bounds = abs(float(np.trace(G.A))) / G.order, float(np.linalg.norm(G.A, np.inf))
    sizes = [*bounds, *(float(np.max(np.abs(part), initial=0.0)) for part in (G.B, G.C))]
    if not min(sizes):
        return False
    slowest, fastest, b, c = map(math.log2, sizes)
    is_usual = b + c - 2.0 * fastest > -20 * _GAIN_BITS and b + c - 2.0 * slowest < _GAIN_BITS
    return is_usual and max(abs(slowest), abs(fastest)) <= _SPEED_BITS


class _Image(NamedTuple):
    """A continuous system in orthogonal coordinates of inputs and outputs in which D is diagonal."""

    A: Matrix
    """(n, n)."""
    B: Matrix
    """(n, m)."""
    C: Matrix
    """(p, n)."""
    s: Matrix
    """(min(p, m),) the singular values of D."""


def _diagonal_image(G: Lti) -> _Image:
    if not G.D.any():
        return _Image(G.A, G.B, G.C, np.zeros(min(G.D.shape)))
    U, s, Vt = np.linalg.svd(G.D)
    return _Image(G.A, G.B @ Vt.T, U.T @ G.C, s)


def _stable_peak(curve: GainCurve, accuracy: float) -> Peak:
    """Return the peak of a stable system, its frequency that of the continuous image."""
    image = bilinear_transform(curve.G) if curve.G.dt else curve.G
    diagonal = _diagonal_image(image)
    best = Peak(gain=curve.at_half_rate() if curve.G.dt else float(diagonal.s[0]), omega=np.inf)
    grid = curve.frequencies()
    gains = curve.sample(grid)
    best = _higher(best, *curve.climb(grid, gains))
    if best.gain <= 0.0:
        return Peak(gain=best.gain, omega=best.omega, error=0.0)
    for _ in range(_LOOKS):
        best, done = _look_just_below(curve, diagonal, best, accuracy, grid, gains)
        if done:
            return Peak(gain=best.gain, omega=best.omega, error=2.0 * accuracy * best.gain + curve.rounding(best.omega))
    return _search_in_rounds(curve, image, diagonal, best, accuracy, (grid, gains))


def _search_in_rounds(
    curve: GainCurve, image: Lti, diagonal: _Image, best: Peak, accuracy: float, samples: tuple[Array, Array]
) -> Peak:
    """Return the peak of which one look just below did not settle the gain, with its error."""
    grid, _ = samples
    best = _raise_lower_bound(curve, diagonal, best, accuracy)
    unseen = _least_distance_seen(diagonal, best, *samples)
    if unseen > _SEEN_BELOW[0]:
        # what rounding hides in these coordinates, it may leave visible in others
        try:
            with np.errstate(over="raise", invalid="raise"):
                other = _diagonal_image(balanced_realization(image)[0])
            best = _raise_lower_bound(curve, other, best, accuracy)
            unseen = min(unseen, _least_distance_seen(other, best, *samples))
        except (np.linalg.LinAlgError, ArithmeticError, ValueError):
            pass
    rounding = curve.rounding(best.omega)
    if unseen > _SEEN_BELOW[0] and rounding > _NOISE * best.gain:
        # the gain is rounding of a system that is nearly 0: there is no peak to see
        most = max(rounding, *(curve.rounding(omega) for omega in grid))
        return Peak(gain=best.gain, omega=best.omega, error=best.gain + most)
    searched = max(2.0 * accuracy, unseen if unseen > _SEEN_BELOW[0] else 0.0)
    return Peak(gain=best.gain, omega=best.omega, error=searched * best.gain + rounding)


def _look_just_below(
    curve: GainCurve, image: _Image, best: Peak, accuracy: float, grid: Array, gains: Array
) -> tuple[Peak, bool]:
    """Return the peak, raised, and whether one look at the Hamiltonian matrix settles it.

    It does if the only band just below the peak is narrow and about it: there the gain is a parabola. Then the matrix
    sees the peak, and no other.
    """
    if math.isinf(best.omega):
        return best, False
    level = (1.0 - _SEEN_BELOW[0]) * best.gain
    crossings, near = _crossings(image, level)
    higher = _higher(best, *curve.highest(np.concatenate([_candidates(crossings), near])))
    first, last = _surroundings(best, grid, gains, level)
    if crossings.size != (2 if best.omega else 1) or higher.gain > (1.0 + accuracy) * best.gain:
        return higher, False
    low, high = float(crossings[0]) if best.omega else 0.0, float(crossings[-1])
    left, right = _surroundings(best, grid, gains, (1.0 - _FAR_BELOW) * best.gain)
    return higher, first <= low <= best.omega <= high <= last and high - low <= _NARROW * (right - left)


def _surroundings(best: Peak, grid: Array, gains: Array, level: float) -> tuple[float, float]:
    """Return the nearest samples on both sides of a peak with gains below a level; 0 and infinite without one."""
    lower = grid[gains < level]
    at = int(lower.searchsorted(best.omega))
    return float(lower[at - 1]) if at else 0.0, float(lower[at]) if at < lower.size else math.inf


def _raise_lower_bound(curve: GainCurve, image: _Image, best: Peak, accuracy: float) -> Peak:
    """Return the peak after rounds with the Hamiltonian matrix of a continuous `image` of the system."""
    for excess in _LEVEL_EXCESSES:
        if math.isinf(best.omega):
            crossings, _ = _crossings(image, (1.0 + excess) * best.gain)
            best = _higher(best, *curve.highest(_candidates(crossings)))
    for _ in range(60):
        crossings, near = _crossings(image, (1.0 + 2.0 * accuracy) * best.gain)
        # crossings that rounding moved off the axis are near it: the gain is tried at all eigenvalues
        higher = _higher(best, *curve.highest(np.concatenate([_candidates(crossings), _candidates(near)])))
        if higher.gain <= (1.0 + accuracy) * best.gain:
            return higher
        best = higher
    raise DesignError("the H-infinity norm did not settle in 60 rounds; the system is badly scaled")


def _higher(best: Peak, omega: float, gain: float) -> Peak:
    return Peak(gain=gain, omega=omega) if gain > best.gain else best


def _least_distance_seen(image: _Image, best: Peak, grid: Array, gains: Array) -> float:
    """Return the least relative distance below a peak at which the Hamiltonian matrix has crossings beside it.

    There is one between the peak and the nearest sample on each side whose gain is lower; infinite if none is seen.
    """
    for distance in _SEEN_BELOW:
        level = (1.0 - distance) * best.gain
        if np.all(gains >= level):
            return distance  # a flat gain: nothing crosses the level
        first, last = _surroundings(best, grid, gains, level)
        crossings, _ = _crossings(image, level)
        if np.any((crossings >= first) & (crossings <= last)):
            return distance
    return math.inf


def _candidates(crossings: Matrix) -> Matrix:
    """Return the crossings and the middles of the bands between them; 0 alone if there are no crossings.

    Where the gain is flat, rounding hides crossings and bands look half open. So 0 and twice the last crossing count as
    ends too, and a band is tried at its arithmetic and its geometric middle.
    """
    if crossings.size == 0:
        return np.zeros(1)
    ends = np.concatenate([[0.0], crossings, [2.0 * crossings[-1]]])
    return np.concatenate([crossings, 0.5 * (ends[:-1] + ends[1:]), np.sqrt(ends[1:-1] * ends[2:])])


def _crossings(image: _Image, level: float) -> tuple[Matrix, Matrix]:
    """Return the frequencies >= 0, ascending, where a singular value may equal `level`, and those of all eigenvalues.

    No singular value of D may equal the level.
    """
    A, B, C, s = image
    n, k = len(A), len(s)
    gap = (level - s) * (level + s)
    # the factor `level` is split between B and C to give both halves the same size
    by_input, by_output = np.full(B.shape[1], 1.0 / level), np.full(C.shape[0], 1.0 / level)
    by_input[:k] = by_output[:k] = level / gap
    H = np.empty((2 * n, 2 * n))
    H[:n, :n] = A + (B[:, :k] * (s / gap)) @ C[:k] if s.any() else A
    H[:n, n:], H[n:, :n], H[n:, n:] = (B * by_input) @ B.T, -(C.T * by_output) @ C, -H[:n, :n].T
    values = eigenvalues(H)
    values = values[values.imag >= 0.0]
    size = np.abs(values)
    on_axis = np.abs(values.real) <= _AXIS_TOLERANCE * size + 1e-13 * size.max()
    return np.sort(values.imag[on_axis]), np.sort(values.imag)
