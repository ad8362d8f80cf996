"""The controller that Lyapunov matrices of a scheduled synthesis imply at one point, and the gain that they prove."""

import numpy as np

from gustproof.errors import DesignError
from gustproof.robust.gain.multipliers import least_level
from gustproof.robust.lpv.inequalities import LyapunovMatrices, Point
from gustproof.robust.lti.state_space import Lti, Matrix, PartedPlant, lft

_FULL_RANK = 1e-10
"""[-] relative size of the least singular value of D12 or D21 from which it counts as of full rank."""


def controller_at(plant: PartedPlant, matrices: LyapunovMatrices, rho: Point, drho: Point, level: float) -> Lti:
    """Return the controller, `u = K y`, at the point `rho` and the speeds `drho` of the parameters.

    Raises
    ------
    DesignError
        If D12 has not full column rank or D21 not full row rank, or D11 alone exceeds the level.

    References
    ----------
    P. Apkarian, R. J. Adams, Advanced gain-scheduling techniques for uncertain systems, IEEE Trans. Control Systems
    Technology 6 (1998), 21-32, Eq. 20 to 24.
    """
    (X, Y), (dX, _) = matrices.at(rho), matrices.speed(rho, drho)
    p, n = plant, len(X)
    D_K = _feedthrough(p, rho, level)
    A, B1, C1 = p.A + p.B2 @ D_K @ p.C2, p.B1 + p.B2 @ D_K @ p.D21, p.C1 + p.D12 @ D_K @ p.C2
    D11 = p.D11 + p.D12 @ D_K @ p.D21
    B_hat = _gain(p.D21, D11.T, p.C2, np.vstack([p.B1.T @ X, C1]), level).T
    C_hat = _gain(p.D12.T, D11, p.B2.T, np.vstack([p.C1 @ Y, B1.T]), level)
    m, q = p.B1.shape[1], p.C1.shape[0]
    middle = np.block([[-level * np.eye(m), D11.T], [D11, -level * np.eye(q)]])
    left = np.hstack([X @ p.B1 + B_hat @ p.D21, C1.T])
    A_hat = -A.T + left @ np.linalg.solve(middle, np.vstack([B1.T, p.C1 @ Y + p.D12 @ C_hat]))
    Mt = np.eye(n) - X @ Y  # N is 1
    moved = A_hat - X @ (p.A - p.B2 @ D_K @ p.C2) @ Y - B_hat @ p.C2 @ Y - X @ p.B2 @ C_hat - dX @ Y
    inverse = np.linalg.inv(Mt)
    K = Lti(A=moved @ inverse, B=B_hat - X @ p.B2 @ D_K, C=(C_hat - D_K @ p.C2 @ Y) @ inverse, D=D_K)
    return _without_feedthrough(K, p.D22)


def _gain(D: Matrix, D11: Matrix, own: Matrix, others: Matrix, level: float) -> Matrix:
    """Return the gain of one side from its linear equations."""
    k, (m, p) = D.shape[0], D11.shape
    whole = np.zeros((k + m + p, k + m + p))
    whole[:k, k : k + m], whole[k : k + m, :k] = D, D.T
    whole[k : k + m, k : k + m], whole[k + m :, k + m :] = -level * np.eye(m), -level * np.eye(p)
    whole[k : k + m, k + m :], whole[k + m :, k : k + m] = D11, D11.T
    return np.asarray(-np.linalg.solve(whole, np.vstack([own, others]))[:k])


def _feedthrough(p: PartedPlant, rho: Point, level: float) -> Matrix:
    """Return the central D_K with `D11 + D12 D_K D21` below the level."""
    where = f"at {rho}"
    U, s, Vt = np.linalg.svd(p.D12)
    W, t, Zt = np.linalg.svd(p.D21)
    m2, p2 = p.D12.shape[1], p.D21.shape[0]
    if s.size < m2 or s[-1] <= _FULL_RANK * s[0]:
        raise DesignError(f"D12 {where} has not full column rank: weight every control in z")
    if t.size < p2 or t[-1] <= _FULL_RANK * t[0]:
        raise DesignError(f"D21 {where} has not full row rank: add noise to every measurement in w")
    inner = U.T @ p.D11 @ Zt.T
    D1111, D1112, D1121, D1122 = inner[m2:, p2:], inner[m2:, :p2], inner[:m2, p2:], inner[:m2, :p2]
    size = D1111.shape[0]
    inside = level**2 * np.eye(size) - D1111 @ D1111.T
    if size and np.linalg.eigvalsh(inside)[0] <= 0.0:
        raise DesignError(f"D11 {where} alone exceeds the level {level:.6g}")
    D_hat = -D1121 @ D1111.T @ np.linalg.solve(inside, D1112) - D1122
    return np.asarray(Vt.T @ (D_hat / s[:, None] / t) @ W.T, dtype=np.float64)


def _without_feedthrough(K: Lti, D22: Matrix) -> Lti:
    """Return the controller of the plant with D22, from that of the plant without."""
    if not np.any(D22):
        return K
    m, p = K.D.shape
    reading = Lti(
        A=K.A,
        B=np.hstack([K.B, K.B]),
        C=np.vstack([K.C, K.C]),
        D=np.tile(K.D, (2, 2)),
    )
    return lft(reading, Lti(A=np.zeros((0, 0)), B=np.zeros((0, m)), C=np.zeros((p, 0)), D=-D22))


def lyapunov_matrix(matrices: LyapunovMatrices, rho: Point, drho: Point) -> tuple[Matrix, Matrix]:
    """Return the closed loop's matrix, of the states of plant and controller, and its derivative by time."""
    (X, Y), (dX, dY) = matrices.at(rho), matrices.speed(rho, drho)
    n = len(X)
    identity, zero = np.eye(n), np.zeros((n, n))
    inverse = np.linalg.inv(np.block([[Y, identity], [identity - X @ Y, zero]]))
    P = np.block([[identity, X], [zero, identity]]) @ inverse
    turning = np.block([[dY, zero], [-dX @ Y - X @ dY, zero]])
    dP = (np.block([[zero, dX], [zero, zero]]) - P @ turning) @ inverse
    return np.asarray(0.5 * (P + P.T)), np.asarray(0.5 * (dP + dP.T))


def proven_level(loop: Lti, matrices: LyapunovMatrices, rho: Point, drho: Point, level: float) -> float:
    """Return the least gain for which the loop's dissipation inequality holds at a point and speeds; or infinity.

    Its storage is the Lyapunov matrix of the design, which belongs to `level`.
    """
    P, dP = (level * matrix for matrix in lyapunov_matrix(matrices, rho, drho))
    if np.linalg.eigvalsh(P)[0] <= 0.0:
        return np.inf
    # in the coordinates where P is 1 the inequality is well scaled
    root = np.linalg.cholesky(P).T
    inverse = np.linalg.inv(root)
    A, B, C = root @ loop.A @ inverse, root @ loop.B, loop.C @ inverse
    corner = A + A.T + inverse.T @ dP @ inverse + C.T @ C
    cross = B + C.T @ loop.D
    found = least_level(np.block([[corner, cross], [cross.T, loop.D.T @ loop.D]]), loop.n_inputs)
    return np.inf if found is None else found
