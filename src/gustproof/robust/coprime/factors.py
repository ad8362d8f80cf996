"""Normalised coprime factors of a plant, and the controller that withstands the most uncertainty of them."""

from dataclasses import dataclass

import numpy as np
import scipy

from gustproof.errors import DesignError
from gustproof.robust.lti.bilinear import bilinear_transform
from gustproof.robust.lti.riccati import RiccatiError, RiccatiFailure, stabilizing_solution
from gustproof.robust.lti.state_space import Lti, Matrix

_MAPPABLE = 1e12
"""[-] condition of `I + A` beyond which a discrete pole counts as -1, where it has no continuous image."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoprimeFactors:
    """Solutions of the two Riccati equations of a continuous plant.

    References
    ----------
    K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control, Prentice Hall 1996, section 13.8: the factors with
    feedthrough.
    """

    G: Lti
    """The plant, of n states, m inputs and p outputs."""
    R: Matrix
    """(p, p) I + D D^T."""
    S: Matrix
    """(m, m) I + D^T D."""
    X: Matrix
    """(n, n) solution of the control equation."""
    Z: Matrix
    """(n, n) solution of the filter equation."""

    @property
    def least_gamma(self) -> float:
        """Return the least H-infinity norm of `[K; I] (I - G K)^-1 [I, G]` over all stabilising K, [-]."""
        XZ = np.linalg.eigvals(self.X @ self.Z).real
        return float(np.sqrt(1.0 + np.max(XZ, initial=0.0)))

    @property
    def F(self) -> Matrix:
        """(m, n) state feedback of the right factors, `A + B F` stable."""
        return np.asarray(-np.linalg.solve(self.S, self.G.D.T @ self.G.C + self.G.B.T @ self.X), dtype=np.float64)

    def graph(self) -> Lti:
        """Return the right factors `[N; M]`, (p + m, m), an isometry on the axis with `G = N M^-1`."""
        G, F = self.G, self.F
        root = np.linalg.inv(scipy.linalg.sqrtm(self.S).real)
        C, D = np.vstack([G.C + G.D @ F, F]), np.vstack([G.D @ root, root])
        return Lti(A=G.A + G.B @ F, B=G.B @ root, C=C, D=D)

    def inverse_graph(self) -> Lti:
        """Return the left factors `[M~, -N~]`, (p, p + m), with `G = M~^-1 N~`; 0 on the right ones of `G`."""
        G = self.G
        L = -np.linalg.solve(self.R, G.D @ G.B.T + G.C @ self.Z).T
        root = np.linalg.inv(scipy.linalg.sqrtm(self.R).real)
        B, D = np.hstack([L, -(G.B + L @ G.D)]), np.hstack([root, -root @ G.D])
        return Lti(A=G.A + L @ G.C, B=B, C=root @ G.C, D=D)

    def robust_controller(self, gamma: float) -> Lti:
        """Return a controller, `u = K y`, with which the norm of `least_gamma` is at most `gamma`, above the least.

        References
        ----------
        S. Skogestad, I. Postlethwaite, Multivariable Feedback Control, 2nd edition 2005, section 9.4, Eq. 9.70 to 9.73.
        """
        G, F = self.G, self.F
        L = (1.0 - gamma**2) * np.eye(G.order) + self.X @ self.Z
        entry: Matrix = np.asarray(gamma**2 * np.linalg.solve(L.T, self.Z @ G.C.T), dtype=np.float64)
        return Lti(A=G.A + G.B @ F + entry @ (G.C + G.D @ F), B=entry, C=G.B.T @ self.X, D=-G.D.T)


def coprime_factors(G: Lti) -> CoprimeFactors:
    """Return the normalised coprime factors of a plant; of a discrete one, those of its bilinear image.

    Raises
    ------
    DesignError
        If a mode on the axis is hidden from inputs or outputs, an unstable one is nearly so, or a discrete plant has a
        pole at -1.
    """
    if G.dt:
        if G.order and np.linalg.cond(np.eye(G.order) + G.A) > _MAPPABLE:
            raise DesignError("the plant has a pole at -1, which has no continuous image")
        G = bilinear_transform(G)
    A, B, C, D = G.A, G.B, G.C, G.D
    R, S = np.eye(G.n_outputs) + D @ D.T, np.eye(G.n_inputs) + D.T @ D
    A0 = A - B @ np.linalg.solve(S, D.T @ C)
    by_input, by_output = B @ np.linalg.solve(S, B.T), C.T @ np.linalg.solve(R, C)
    X = _solution(np.block([[A0, -by_input], [-by_output, -A0.T]]))
    Z = _solution(np.block([[A0.T, -by_output], [-by_input, -A0]]))
    return CoprimeFactors(G=G, R=R, S=S, X=X, Z=Z)


def _solution(H: Matrix) -> Matrix:
    """Return the stabilising solution, or raise in the words of the plant."""
    if not H.size:
        return np.zeros((0, 0))
    try:
        return stabilizing_solution(H)
    except RiccatiError as error:
        if error.failure is RiccatiFailure.AXIS:
            text = "the plant has a mode on the axis that inputs do not reach or outputs do not see"
        else:
            text = "the plant is not stabilisable and detectable"
        raise DesignError(f"{text}: no coprime factors") from None
