"""H-infinity and H2 norms of linear systems, continuous and discrete."""

import math
from dataclasses import dataclass

import numpy as np
import scipy
from scipy.linalg.lapack import dgeev

from gustproof.errors import DesignError
from gustproof.lti.bilinear import bilinear_transform
from gustproof.lti.state_space import ComplexMatrix, LinearSystem, Lti, Matrix, as_lti
from gustproof.types import Array

_AXIS_TOLERANCE = 1e-6
"""[-] eigenvalues with a real part below this fraction of their magnitude, or below rounding, count as crossings."""

_STIFF = 1e5
"""[-] ratio of fastest to slowest pole beyond which rounding hides crossings at the slow end."""
_PER_DECADE = 20
"""Number of frequencies a decade at which the gain of such a system is computed before the search."""

_LEVEL_EXCESSES = (1e-4, 1e-6, 1e-8)
"""[-] relative excess over the gain at infinity of the levels tried first, while no larger gain is known. Closer to
that gain the Hamiltonian matrix grows without bound, and its rounding hides crossings."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Peak:
    """Largest gain of a system over all frequencies, and its frequency."""

    gain: float
    """[-] largest singular value; infinite for an unstable system."""
    omega: float
    """[rad/s] frequency of the peak; infinite if the gain only tends to it."""


def hinf_norm(system: LinearSystem, *, accuracy: float = 1e-9) -> Peak:
    """Return the H-infinity norm and its frequency.

    The eigenvalues of a Hamiltonian matrix give the frequency bands in which the gain exceeds a lower bound. The bound
    is raised to the gain at the middle of these bands until no band is left; convergence is quadratic. A discrete
    system is mapped by the bilinear transformation, which keeps the norm. An unstable system has an infinite norm.
    Each round costs an eigenvalue problem of order 2n. Rounding may hide crossings of a stiff system, so its gain is
    first searched on a grid. The norm lies between the result and (1 + 2 `accuracy`) times it, up to rounding.

    Raises
    ------
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
    G = as_lti(system)
    poles = eigenvalues(G.A)
    beyond = np.abs(poles) - 1.0 if G.dt else poles.real
    if np.max(beyond, initial=-1.0) >= 0.0:
        worst = poles[np.argmax(beyond)]
        return Peak(gain=np.inf, omega=float(abs(np.angle(worst)) / G.dt if G.dt else abs(worst.imag)))
    if not G.dt:
        return _continuous_peak(G, poles, accuracy)
    peak = _continuous_peak(bilinear_transform(G), 2.0 / G.dt * (poles - 1.0) / (poles + 1.0), accuracy)
    return Peak(gain=peak.gain, omega=2.0 / G.dt * float(np.arctan(peak.omega * G.dt / 2.0)))


def eigenvalues(A: Matrix) -> ComplexMatrix:
    """Return the eigenvalues of a small real matrix; numpy's own function takes twice as long.

    Raises
    ------
    ValueError
        If `A` is not finite.
    LinAlgError
        If they did not converge.
    """
    if not A.size:
        return np.zeros(0, dtype=np.complex128)
    if not np.isfinite(A).all():
        raise ValueError("the matrix has what is no number or infinite")
    real, imaginary, _, _, failed = dgeev(A, compute_vl=0, compute_vr=0)
    if failed:
        raise np.linalg.LinAlgError("the eigenvalues did not converge")
    return np.asarray(real + 1j * imaginary)


def h2_norm(system: LinearSystem) -> float:
    """Return the H2 norm: rms output for white noise of unit density (continuous) or unit variance a sample (discrete).

    Infinite for an unstable system, and for a continuous one with feedthrough.

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
    if not G.is_stable() or (not G.dt and np.any(G.D)):
        return float("inf")
    if not G.order:
        return float(np.linalg.norm(G.D))
    if G.dt:
        gramian = scipy.linalg.solve_discrete_lyapunov(G.A, G.B @ G.B.T)
    else:
        gramian = scipy.linalg.solve_continuous_lyapunov(G.A, -G.B @ G.B.T)
    return float(np.sqrt(max(np.trace(G.C @ gramian @ G.C.T) + np.sum(G.D**2), 0.0)))


def _continuous_peak(G: Lti, poles: ComplexMatrix, accuracy: float) -> Peak:
    at_infinity = float(np.linalg.norm(G.D, 2)) if G.D.any() else 0.0
    best = Peak(gain=at_infinity, omega=np.inf)
    if not G.order or not G.D.size:
        return best
    size = np.abs(poles)
    resonance = size * np.sqrt(np.maximum(1.0 - 2.0 * (poles.real / size) ** 2, 0.0))
    best = _raise_lower_bound(G, best, np.unique(np.concatenate([[0.0], size, resonance])))
    slowest, fastest = np.min(size), np.max(size)
    if fastest > _STIFF * slowest:
        best = _search_grid(G, best, max(slowest, 1e-9 * fastest), fastest)
    if best.gain <= 0.0:
        return best
    for excess in _LEVEL_EXCESSES:
        if math.isinf(best.omega):
            best = _raise_lower_bound(G, best, _candidates(_crossings(G, (1.0 + excess) * best.gain)))
    for _ in range(60):
        candidates = _candidates(_crossings(G, (1.0 + 2.0 * accuracy) * best.gain))
        if candidates.size == 0:
            return best
        higher = _raise_lower_bound(G, best, candidates)
        if higher.gain <= (1.0 + accuracy) * best.gain:
            return higher
        best = higher
    raise DesignError("the H-infinity norm did not settle in 60 rounds; the system is badly scaled")


def _candidates(crossings: Matrix) -> Matrix:
    """Return the crossings and the middles of the bands between them; empty if there are no crossings.

    Where the gain is flat, rounding hides crossings and bands look half open. So 0 and twice the last crossing count as
    ends too, and a band is tried at its arithmetic and its geometric middle.
    """
    if crossings.size == 0:
        return crossings
    ends = np.concatenate([[0.0], crossings, [2.0 * crossings[-1]]])
    return np.concatenate([crossings, 0.5 * (ends[:-1] + ends[1:]), np.sqrt(ends[1:-1] * ends[2:])])


def _search_grid(G: Lti, best: Peak, slowest: float, fastest: float) -> Peak:
    """Return the largest gain on a grid that covers the poles, refined to its local maximum."""
    grid = np.geomspace(slowest / 10.0, fastest, 2 + round(_PER_DECADE * math.log10(10.0 * fastest / slowest)))
    found = _raise_lower_bound(G, best, grid)
    if found is best:
        return best
    step = math.log(grid[1] / grid[0])
    best_shift = scipy.optimize.minimize_scalar(
        lambda shift: -np.linalg.norm(G.response([found.omega * math.exp(shift)]), 2, axis=(1, 2))[0],
        bounds=(-step, step),
        method="bounded",
        options={"xatol": 1e-9},
    )
    return _raise_lower_bound(G, found, found.omega * np.exp([best_shift.x]))


def _raise_lower_bound(G: Lti, best: Peak, omega: Array) -> Peak:
    if omega.size == 0:
        return best
    gains = np.linalg.svd(G.response(omega), compute_uv=False)[:, 0]
    k = int(np.argmax(gains))
    return Peak(gain=float(gains[k]), omega=float(omega[k])) if gains[k] > best.gain else best


def _crossings(G: Lti, level: float) -> Matrix:
    """Return the frequencies >= 0, ascending, where a singular value may equal `level` (> sigma_max(D))."""
    # the factor `level` is split between B and C to give both halves the same size
    A, B, C = G.A, G.B.T / level, G.C / level
    if G.D.any():
        R = level**2 * np.eye(G.n_inputs) - G.D.T @ G.D
        S = level**2 * np.eye(G.n_outputs) - G.D @ G.D.T
        A = np.asarray(A + G.B @ np.linalg.solve(R, G.D.T @ G.C), dtype=np.float64)
        B = np.asarray(level * np.linalg.solve(R, G.B.T), dtype=np.float64)
        C = np.asarray(level * np.linalg.solve(S, G.C), dtype=np.float64)
    n = G.order
    H = np.empty((2 * n, 2 * n))
    H[:n, :n], H[:n, n:], H[n:, :n], H[n:, n:] = A, G.B @ B, -G.C.T @ C, -A.T
    values = eigenvalues(H)
    size = np.abs(values)
    on_axis = np.abs(values.real) <= _AXIS_TOLERANCE * size + 1e-13 * np.max(size)
    return np.sort(values.imag[on_axis & (values.imag >= 0.0)])
