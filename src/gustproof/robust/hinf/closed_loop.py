"""The norm of the loop that a controller closes, and how far rounding may have moved it."""

import numpy as np

from gustproof.robust.lti.norms import Peak, hinf_norm
from gustproof.robust.lti.state_space import Lti, lft

_NORM_ACCURACY = 1e-9
"""[-] relative accuracy of the search for the peak of the closed loop."""
_ROUNDING = float(np.finfo(float).eps)
"""[-] relative rounding of each term of the loop's equations."""


def loop_norm(P: Lti, K: Lti) -> tuple[Peak, float]:
    """Return the H-infinity norm of the loop of `P` and `K`, and its error.

    Raises
    ------
    ValueError
        If the loop is not well posed.
    DesignError
        If rounding dominates the search.
    """
    peak = hinf_norm(lft(P, K), accuracy=_NORM_ACCURACY)
    return peak, peak.error + _rounding(P, K, peak) if np.isfinite(peak.gain) else np.inf


def _rounding(P: Lti, K: Lti, peak: Peak) -> float:
    """Return a bound of how much the gain at the peak moves if rounding moves each number.

    The equations are those of plant and controller together: each term of them, and of z, is off by its rounding.
    """
    if not np.isfinite(peak.omega):
        return 0.0
    n, k, m2, p2 = P.order, K.order, K.n_outputs, K.n_inputs
    p1, m1 = P.n_outputs - p2, P.n_inputs - m2
    point = np.exp(1j * peak.omega * P.dt) if P.dt else 1j * peak.omega
    equations = np.zeros((n + k + m2 + p2, n + k + m2 + p2), dtype=np.complex128)
    x, x_K, u, y = slice(n), slice(n, n + k), slice(n + k, n + k + m2), slice(n + k + m2, None)
    equations[x, x], equations[x, u] = point * np.eye(n) - P.A, -P.B[:, m1:]
    equations[x_K, x_K], equations[x_K, y] = point * np.eye(k) - K.A, -K.B
    equations[u, u], equations[u, x_K], equations[u, y] = np.eye(m2), -K.C, -K.D
    equations[y, y], equations[y, x], equations[y, u] = np.eye(p2), -P.C[p1:], -P.D[p1:, m1:]
    driven = np.zeros((len(equations), m1))
    driven[x], driven[y] = P.B[:, :m1], P.D[p1:, :m1]
    signals = np.linalg.solve(equations, driven)
    z = np.hstack([P.C[:p1], np.zeros((p1, k)), P.D[:p1, m1:], np.zeros((p1, p2))])
    moved = np.abs(np.linalg.solve(equations.T, z.T.astype(np.complex128)).T)
    # z and A nearly cancel where a discrete loop is slow, so each counts by itself
    sizes = np.abs(equations)
    sizes[x, x], sizes[x_K, x_K] = abs(point) * np.eye(n) + np.abs(P.A), abs(point) * np.eye(k) + np.abs(K.A)
    terms = sizes @ np.abs(signals) + np.abs(driven)
    own = np.abs(z) @ np.abs(signals) + np.abs(P.D[:p1, :m1])
    return _ROUNDING * float(np.linalg.norm(moved @ terms + own, 2))
