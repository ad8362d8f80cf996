"""Conditions of an H-infinity problem, checked by name, and its normal form D12 = [0; I], D21 = [0, I]."""

from dataclasses import dataclass

import numpy as np

from gustproof.errors import DesignError
from gustproof.robust.hinf.axis_zeros import AxisZeros, find_axis_zeros
from gustproof.robust.lti.norms import eigenvalues
from gustproof.robust.lti.state_space import Lti, Matrix, largest_gain, part

_RANK = 1e-10
"""[-] singular values below this fraction of the largest count as zero."""
_AXIS = 1e-10
"""[-] eigenvalues with a real part below this fraction of the norm of the matrix count as on the imaginary axis."""


class SingularProblemError(DesignError):
    """The Riccati equations do not exist: D12 or D21 lacks rank, or there is a zero on the imaginary axis.

    A regularised problem has no such fault.
    """


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NormalizedPlant:
    """A generalised plant with w and z rotated, u and y scaled: D12 = [0; I] and D21 = [0, I]."""

    A: Matrix
    """(n, n)."""
    B: Matrix
    """(n, m1 + m2), of (w, u)."""
    C: Matrix
    """(p1 + p2, n), of (z, y)."""
    D: Matrix
    """(p1 + p2, m1 + m2), with D22 = 0."""
    D22: Matrix
    """(p2, m2) feedthrough from u to y in the plant's own units, restored at the end."""
    control_scale: Matrix
    """(m2, m2) u = control_scale u_normalised."""
    measurement_scale: Matrix
    """(p2, p2) y_normalised = measurement_scale y."""
    m1: int
    """Number of exogenous inputs w."""
    p1: int
    """Number of outputs z to keep small."""
    control_zeros: AxisZeros
    """Zeros from u to z near the imaginary axis."""
    filter_zeros: AxisZeros
    """Zeros from w to y near the imaginary axis."""

    @property
    def m2(self) -> int:
        """Number of controls."""
        return int(self.control_scale.shape[0])

    @property
    def p2(self) -> int:
        """Number of measurements."""
        return int(self.measurement_scale.shape[0])

    @property
    def floor(self) -> float:
        """[-] lower bound of the level for all controllers, from the part of D11 that no controller affects."""
        D11 = self.D[: self.p1, : self.m1]
        rows, columns = D11[: self.p1 - self.m2], D11[:, : self.m1 - self.p2]
        return max(largest_gain(part) if part.size else 0.0 for part in (rows, columns))

    @property
    def size(self) -> float:
        """[-] size of the gain from w to z without control."""
        A, B1, C1, D11 = self.A, self.B[:, : self.m1], self.C[: self.p1], self.D[: self.p1, : self.m1]
        rate = largest_gain(A)
        return max(largest_gain(D11), largest_gain(C1) * largest_gain(B1) / rate if rate else 0.0)

    def to_plant_units(self, A: Matrix, B: Matrix, C: Matrix, D: Matrix) -> Lti:
        """Return the controller of the plant for the controller `C (s I - A)^-1 B + D` of the normal form."""
        B, C = B @ self.measurement_scale, self.control_scale @ C
        D = self.control_scale @ D @ self.measurement_scale
        if not self.D22.any():
            return Lti(A=A, B=B, C=C, D=D)
        # the input of K is y - D22 u: u = C x + D (y - D22 u)
        closing = np.eye(self.m2) + D @ self.D22
        if np.linalg.cond(closing) > 1e12:
            raise DesignError("the loop is not well posed: I + D_K D22 is singular")
        C, D = np.split(np.linalg.solve(closing, np.hstack([C, D])), [len(A)], axis=1)
        return Lti(A=A - B @ self.D22 @ C, B=B - B @ self.D22 @ D, C=C, D=D)


def require_sizes(P: Lti, n_meas: int, n_con: int) -> None:
    """Raise a `ValueError` if a plant has no states, a number is no integer, or none of w, z, u or y are left."""
    for name, number in (("n_meas", n_meas), ("n_con", n_con)):
        if isinstance(number, bool) or not isinstance(number, (int, np.integer)):
            raise ValueError(f"{name} is {number!r}, must be an integer")
    if min(n_con, n_meas, P.n_inputs - n_con, P.n_outputs - n_meas) < 1:
        raise ValueError(
            f"P is {P.n_outputs} x {P.n_inputs}: n_meas = {n_meas} and n_con = {n_con} leave no w, z, u or y"
        )
    if not P.order:
        raise ValueError("P must have at least one state")


def normalize(P: Lti, n_meas: int, n_con: int) -> NormalizedPlant:
    """Return the normal form of `P`, or raise an error that names the failed condition.

    Raises
    ------
    SingularProblemError
        If D12 or D21 lacks rank, or there is a zero on the imaginary axis.
    DesignError
        If a mode cannot be stabilised or detected.
    """
    m1, p1 = P.n_inputs - n_con, P.n_outputs - n_meas
    parts = part(P, n_meas, n_con)
    scale = max(largest_gain(P.A), np.finfo(float).tiny)
    poles = eigenvalues(P.A)
    for pole in poles[poles.real >= -_AXIS * scale]:
        _require_controllable(P.A, parts.B2, pole, scale, "P is not stabilisable by u")
        _require_controllable(P.A.T, parts.C2.T, pole, scale, "P is not detectable from y")
    Q_z, control_scale = _complete_basis(parts.D12, "D12 lacks full column rank: {}control {} is not weighted in z")
    Q_w, noise_scale = _complete_basis(parts.D21.T, "D21 lacks full row rank: {}measurement {} has no noise in w")
    measurement_scale = noise_scale.T
    control_zeros = _require_no_axis_zero(P.A, parts.B2 @ control_scale, parts.C1, Q_z[:, -n_con:], "from u to z")
    filter_zeros = _require_no_axis_zero(P.A.T, parts.C2.T @ noise_scale, parts.B1.T, Q_w[:, -n_meas:], "from w to y")
    rows, columns = np.zeros((P.n_outputs, P.n_outputs)), np.zeros((P.n_inputs, P.n_inputs))
    rows[:p1, :p1], rows[p1:, p1:] = Q_z.T, measurement_scale
    columns[:m1, :m1], columns[m1:, m1:] = Q_w, control_scale
    D = rows @ P.D @ columns
    D[p1:, m1:] = 0.0
    return NormalizedPlant(
        A=P.A,
        B=P.B @ columns,
        C=rows @ P.C,
        D=D,
        D22=P.D[p1:, m1:],
        control_scale=control_scale,
        measurement_scale=measurement_scale,
        m1=m1,
        p1=p1,
        control_zeros=control_zeros,
        filter_zeros=filter_zeros,
    )


def _complete_basis(D: Matrix, failure: str) -> tuple[Matrix, Matrix]:
    """Return an orthogonal `Q` and a square `S` with `Q^T D S = [0; I]`; raise if `D` lacks full column rank.

    The text `failure` has places for "a combination" and for the number of the column that is most of it.
    """
    singular, m = np.linalg.svd(D, compute_uv=False), D.shape[1]
    if D.shape[0] < m or singular[-1] <= _RANK * singular[0]:
        null = np.abs(np.linalg.svd(D)[2][-1])
        others = "a combination with most of " if np.sum(null > _RANK * null.max()) > 1 else ""
        raise SingularProblemError(failure.format(others, int(np.argmax(null)) + 1))
    Q, R = np.linalg.qr(D, mode="complete")
    return np.hstack([Q[:, m:], Q[:, :m]]), np.asarray(np.linalg.inv(R[:m]), dtype=np.float64)


def _require_controllable(A: Matrix, B: Matrix, pole: complex, scale: float, failure: str) -> None:
    """Raise if an eigenvalue of A, whose size is `scale`, fails the Popov-Belevitch-Hautus test."""
    pencil = np.hstack([(A - pole * np.eye(len(A))) / scale, B / max(largest_gain(B), np.finfo(float).tiny)])
    if np.linalg.svd(pencil, compute_uv=False)[-1] <= _RANK:
        raise DesignError(f"{failure}: mode at {_format_pole(pole)}")


def _require_no_axis_zero(A: Matrix, B: Matrix, C: Matrix, D: Matrix, path: str) -> AxisZeros:
    """Return the zeros near the axis; raise if one is on it: `[A - jw, B; C, D]` loses column rank there.

    Such zeros are unobservable modes of a reduced pair. The columns of `D` are orthonormal.
    """
    F = D.T @ C
    A_reduced, C_reduced = A - B @ F, C - D @ F
    scale = max(largest_gain(A_reduced), np.finfo(float).tiny)
    size = max(largest_gain(C), np.finfo(float).tiny)
    zeros = find_axis_zeros(A_reduced, C_reduced, scale, size)
    on_axis = zeros.on_axis
    for zero in zeros.others:
        if abs(zero.real) <= _AXIS * scale:
            A_rest, C_rest = zeros.rest.T @ A_reduced @ zeros.rest, C_reduced @ zeros.rest
            pencil = np.vstack([(A_rest - zero * np.eye(len(A_rest))) / scale, C_rest / size])
            if np.linalg.svd(pencil, compute_uv=False)[-1] <= _RANK:
                on_axis = complex(zero)
    if on_axis is not None:
        raise SingularProblemError(f"P has a zero on the imaginary axis {path}: at {_format_pole(on_axis)}")
    return zeros


def _format_pole(value: complex) -> str:
    return f"{value.real:.3g} {value.imag:+.3g}j rad/s"
