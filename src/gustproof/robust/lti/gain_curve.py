"""Gain of a stable linear system over frequency, sampled wherever its poles let it peak."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import zgetrf, zgetrs

from gustproof.robust.lti.state_space import ComplexMatrix, Lti, Matrix
from gustproof.types import Array

_POINTS = 200
"""Least number of frequencies, even in the logarithm, from a tenth of the slowest pole to ten times the fastest."""
_EVEN = np.linspace(0.0, 1.0, _POINTS)
_PER_DECADE = 20
"""Least number of them a decade."""
_BESIDE = np.array([-4.0, -2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0, 4.0])
"""[-] frequencies beside a resonance, in its half widths."""
_TRUSTED = 1e-6
"""[-] largest relative difference of the response by modes from the exact one, at which modes guide the search."""
_WELL_CONDITIONED = 1e3
"""[-] condition of the modes up to which they are not compared: they lose three digits."""
_PROBES = np.linspace(-0.1, 1.1, 8)
"""[-] frequencies at which the two are compared: in the logarithm, from the slowest pole, 0, to the fastest, 1."""
_CLIMBED = 4
"""Number of highest samples whose gain is computed exactly, and of local maxima that are climbed."""
_STEPS = 2
"""Number of parabolas through three samples that lead from one of them to the top."""
_LARGEST_BATCH = 2_000_000
"""Number of coefficients of the matrices solved at once: 32 MB."""
_EPS = float(np.finfo(float).eps)
_ROUNDINGS = 4.0
"""[-] roundings of each term of the equations that a response solves."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GainCurve:
    """Largest singular value of a stable system over frequency: by modes where these serve, exact where it counts.

    A discrete system has the frequencies of its bilinear image: omega is `2/dt tan(theta/2)` at the angle theta of z.
    """

    G: Lti
    """The system, n states in balanced units."""
    poles: ComplexMatrix
    """(n,) [rad/s] poles, of the bilinear image if `G` is discrete."""
    own_poles: ComplexMatrix
    """(n,) eigenvalues of A."""
    residues: ComplexMatrix | None
    """(n, p m) of each mode, to all inputs of the first output, then the next; `None` where rounding spoils these."""

    def exact(self, omega: Array) -> Array:
        """Return the gain (k,) at k finite frequencies [rad/s]; each costs an equation of order n."""
        points = self._points(omega)
        batch = max(1, _LARGEST_BATCH // max(1, self.G.order) ** 2)
        parts = [largest_gains(self.G.transfer(points[k : k + batch])) for k in range(0, points.size, batch)]
        return np.concatenate(parts) if parts else np.zeros(0)

    def at_half_rate(self) -> float:
        """Return the gain of a discrete system at z = -1, the infinite frequency of its image."""
        return float(largest_gains(self.G.transfer(np.array([-1.0 + 0.0j])))[0])

    def sample(self, omega: Array) -> Array:
        """Return the gain (k,) at k finite frequencies [rad/s], by modes if these serve.

        Gains that are clearly not the largest are only bounds from below.
        """
        if self.residues is None:
            return self.exact(omega)
        transfer = self._by_modes(omega)
        if min(transfer.shape[1:]) <= 2:
            return largest_gains(transfer)
        gains, most = _bound_gains(transfer)
        high = most >= np.max(gains)
        gains[high] = largest_gains(transfer[high])
        return gains

    def highest(self, omega: Array) -> tuple[float, float]:
        """Return the frequency [rad/s] of the largest gain among those given, and that gain, exact."""
        if omega.size > _CLIMBED:
            omega = omega[np.argsort(self.sample(omega))[-_CLIMBED:]]
        gains = self.exact(omega)
        k = int(np.argmax(gains))
        return float(omega[k]), float(gains[k])

    def climb(self, omega: Array, gains: Array) -> tuple[float, float]:
        """Return frequency [rad/s] and exact gain of the top of the highest local maxima of samples, (k,) ascending.

        The inverse square of the gain of one resonance is a parabola.
        """
        padded = np.full(gains.size + 2, -np.inf)
        padded[1:-1] = gains
        tops = np.flatnonzero((gains >= padded[:-2]) & (gains >= padded[2:]))
        if tops.size > _CLIMBED:
            tops = tops[np.argsort(gains[tops])[-_CLIMBED:]]
        # frequency and inverse square of the gain, at a top and the samples beside it
        points = np.array([omega, gains])
        with np.errstate(all="ignore"):  # no gain, no parabola, none between the samples: the middle stays
            points[1] **= -2.0
            left, middle = points[:, np.maximum(tops - 1, 0)], points[:, tops]
            right = points[:, np.minimum(tops + 1, omega.size - 1)]
            for _ in range(_STEPS):
                place = _vertices(left, middle, right)
                vertex = np.array([place, self.sample(place) ** -2.0])
                later = place > middle[0]
                first, second = np.where(later, middle, vertex), np.where(later, vertex, middle)
                lower = first[1] <= second[1]
                left, right = np.where(lower, left, first), np.where(lower, second, right)
                middle = np.where(lower, first, second)
        return self.highest(middle[0])

    def rounding(self, omega: float) -> float:
        """Return a bound of how far rounding moves the exact gain at a frequency [rad/s]."""
        G = self.G
        if np.isinf(omega) and not G.dt:
            return _ROUNDINGS * _EPS * float(np.linalg.norm(G.D))
        point = self._points(np.array([omega]))[0]
        factors, pivots, _ = zgetrf(point * np.eye(G.order) - G.A)
        states, seen = np.abs(zgetrs(factors, pivots, G.B)[0]), np.abs(zgetrs(factors, pivots, G.C.T, trans=1)[0]).T
        # z and A nearly cancel where a discrete system is slow, so each counts by itself
        terms = abs(point) * states + np.abs(G.A) @ states + np.abs(G.B)
        moved = seen @ terms + np.abs(G.C) @ states + np.abs(G.D)
        return _ROUNDINGS * _EPS * float(np.linalg.norm(moved))

    def frequencies(self) -> Array:
        """Return where to sample: 0, on and beside each resonance, and a grid over the range of the poles [rad/s]."""
        size = np.abs(self.poles)
        first, last = 0.1 * float(size.min()), 10.0 * float(size.max())
        count = round(_PER_DECADE * np.log10(last / first))
        steps = _EVEN if count <= _POINTS else np.linspace(0.0, 1.0, count)
        grid = first * (last / first) ** steps
        every = np.concatenate([[0.0], beside_resonances(self.poles), grid])
        every.sort()
        return np.asarray(every[np.append(True, every[1:] > every[:-1])])

    def _points(self, omega: Array) -> ComplexMatrix:
        """Return s, or z of a discrete system, at frequencies [rad/s]."""
        if not self.G.dt:
            return np.asarray(1j * omega)
        return np.asarray(np.exp(2j * np.arctan(0.5 * self.G.dt * omega)))

    def _by_modes(self, omega: Array) -> ComplexMatrix:
        assert self.residues is not None
        resolvent = 1.0 / (self._points(omega)[:, None] - self.own_poles)
        return np.asarray((resolvent @ self.residues).reshape(omega.size, *self.G.D.shape) + self.G.D)


def gain_curve(G: Lti, poles: ComplexMatrix, V: ComplexMatrix) -> GainCurve:
    """Return the gain over frequency of a stable system, its states in balanced units.

    `poles`, (n,), and `V`, (n, n), are the eigenvalues and eigenvectors of its A.
    """
    image = 2.0 / G.dt * (poles - 1.0) / (poles + 1.0) if G.dt else poles
    exact = GainCurve(G=G, poles=image, own_poles=poles, residues=None)
    try:
        inverse = np.linalg.inv(V)
    except np.linalg.LinAlgError:
        return exact
    residues = ((G.C @ V).T[:, :, None] * (inverse @ G.B)[:, None, :]).reshape(G.order, -1)
    guided = GainCurve(G=G, poles=image, own_poles=poles, residues=residues)
    if np.linalg.norm(V) * np.linalg.norm(inverse) <= _WELL_CONDITIONED:
        return guided
    size = np.abs(image)
    slow, fast = size.min(), size.max()
    probes = slow * (fast / slow) ** _PROBES if fast > slow else slow * np.array([0.5, 1.0, 2.0])
    expected = G.transfer(guided._points(probes))
    with np.errstate(all="ignore"):  # modes of a defective matrix are huge: the comparison says so
        off = np.abs(guided._by_modes(probes) - expected).max(axis=(1, 2))
    return guided if np.all(off <= _TRUSTED * np.abs(expected).max(axis=(1, 2))) else exact


def beside_resonances(roots: ComplexMatrix) -> Array:
    """Return frequencies [rad/s] at which each of the poles or zeros `roots` [rad/s] may turn a gain, and beside it."""
    roots = roots[roots.imag >= 0.0]
    size, damping = np.abs(roots), np.abs(roots.real)
    resonance = np.sqrt(np.maximum(roots.imag**2 - damping**2, 0.0))
    return np.concatenate([size, resonance, np.abs(roots.imag[:, None] + damping[:, None] * _BESIDE).ravel()])


def _vertices(left: Array, middle: Array, right: Array) -> Array:
    """Return where parabolas through three points, (2, k) each, are least; the middle if it is not between them."""
    (low, at_low), (mid, at_mid), (high, at_high) = left, middle, right
    rise, fall = (mid - low) * (at_mid - at_high), (mid - high) * (at_mid - at_low)
    vertex = mid - 0.5 * ((mid - low) * rise - (mid - high) * fall) / (rise - fall)
    return np.asarray(np.where((vertex > low) & (vertex < high), vertex, mid))


def _bound_gains(matrices: ComplexMatrix) -> tuple[Array, Array]:
    """Return bounds, below and above, of the largest singular value of each of k matrices, (k, p, m).

    The trace of the fourth power of M* M lies between the eighth power of that value and as many times that as there
    are singular values.
    """
    scale = float(np.max(np.abs(matrices))) or 1.0
    tall = matrices if matrices.shape[1] >= matrices.shape[2] else matrices.transpose(0, 2, 1)
    square = tall.conj().transpose(0, 2, 1) @ tall / scale**2
    fourth = np.sum(np.abs(square @ square) ** 2, axis=(1, 2))
    most = scale * fourth**0.125
    return np.asarray(most / tall.shape[2] ** 0.125), np.asarray(most)


def largest_gains(matrices: ComplexMatrix) -> Matrix:
    """Return the largest singular value (k,) of each of k matrices, (k, p, m); two rows or columns in closed form."""
    least = min(matrices.shape[1:])
    if least <= 1:
        return np.asarray(np.linalg.norm(matrices, axis=(1, 2)))
    if least > 2:
        return np.asarray(np.linalg.svd(matrices, compute_uv=False)[:, 0])
    size = float(np.abs(matrices).max(initial=0.0)) or 1.0
    rows = (matrices if matrices.shape[1] == 2 else matrices.mT) / size
    square = rows @ rows.conj().mT
    first, second = square[:, 0, 0].real, square[:, 1, 1].real
    return np.asarray(
        size * np.sqrt(0.5 * (first + second) + np.hypot(0.5 * (first - second), np.abs(square[:, 0, 1])))
    )
