"""Linear systems as read-only arrays, and the border to python-control.

Users plot and check with `control.StateSpace`. It is mutable, drops states on request of a global setting, and spells
"unspecified" as `None`. So functions take any object with `A, B, C, D, dt`, or a `control.TransferFunction`, and
copy it into an `Lti`; `Lti.to_control` alone makes a `control.StateSpace`.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray
from scipy.linalg.lapack import dgesdd

from gustproof.robust.lti.transfer_functions import give_states
from gustproof.robust.shown import Shown
from gustproof.types import readonly_copy

if TYPE_CHECKING:
    import control

_SHOWN_POLES = 6
_UNNAMED = re.compile(r"[uy]\[\d+\]")
"""Names that python-control gives to signals."""

Matrix = NDArray[np.float64]
ComplexMatrix = NDArray[np.complex128]


class LinearSystem(Protocol):
    """Attributes read from a linear system: an `Lti` or a `control.StateSpace`."""

    @property
    def A(self) -> Any:
        """State matrix."""

    @property
    def B(self) -> Any:
        """Input matrix."""

    @property
    def C(self) -> Any:
        """Output matrix."""

    @property
    def D(self) -> Any:
        """Feedthrough matrix."""

    @property
    def dt(self) -> Any:
        """Sample time; 0 for continuous time, which scipy writes as `None`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Lti(Shown):
    """A linear system of n states, m inputs and p outputs; arrays are checked on construction, then read-only.

    Raises
    ------
    ValueError
        If a shape does not fit, a number is not finite, or `dt` is negative.

    Examples
    --------
    >>> from gustproof.robust.lti.state_space import Lti
    >>> lag = Lti(A=[[-2.0]], B=[[2.0]], C=[[1.0]], D=[[0.0]])
    >>> (lag.order, lag.is_stable())
    (1, True)
    >>> lag
    Lti: 1 x 1, 1 state, continuous
    poles: stable, -2
    """

    A: Matrix
    """(n, n) state to derivative, or to next state."""
    B: Matrix
    """(n, m) input to derivative, or to next state."""
    C: Matrix
    """(p, n) state to output."""
    D: Matrix
    """(p, m) input to output."""
    dt: float = 0.0
    """[s] sample time; 0 for continuous time."""

    if TYPE_CHECKING:  # lists are taken, arrays are kept

        def __init__(self, *, A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike, dt: float = 0.0) -> None: ...

    def __post_init__(self) -> None:
        """Check shapes and values, and set the arrays read-only."""
        for name in "ABCD":
            if np.iscomplexobj(getattr(self, name)):
                raise ValueError(f"{name} has complex numbers, must be real")
        D = np.atleast_2d(np.asarray(self.D, dtype=np.float64))
        p, m = D.shape
        n = np.atleast_2d(np.asarray(self.A, dtype=np.float64)).shape[0] if np.size(self.A) else 0
        for name, shape in {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}.items():
            object.__setattr__(self, name, readonly_copy(name, _as_matrix(getattr(self, name), shape), shape))
        if isinstance(self.dt, bool) or not isinstance(self.dt, (int, float, np.number)) or not 0.0 <= self.dt < np.inf:
            raise ValueError(f"dt is {self.dt!r}, must be 0 (continuous) or positive")

    @property
    def order(self) -> int:
        """Number of states."""
        return int(self.A.shape[0])

    @property
    def n_inputs(self) -> int:
        """Number of inputs."""
        return int(self.D.shape[1])

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return int(self.D.shape[0])

    def lines(self) -> list[str]:
        """Return its size, and the slowest poles."""
        title, poles = f"Lti: {self.describe_size()}", self.poles()
        if not len(poles):
            return [title]
        slowest = poles[np.argsort(np.abs(np.log(poles) if self.dt and np.all(poles) else poles), kind="stable")]
        told = ", ".join(f"{pole if pole.imag else pole.real:.4g}" for pole in slowest[:_SHOWN_POLES])
        more = f" and {len(poles) - _SHOWN_POLES} more" if len(poles) > _SHOWN_POLES else ""
        return [title, f"poles: {'stable' if self.is_stable() else 'unstable'}, {told}{more}"]

    def describe_size(self) -> str:
        """Return outputs, inputs, states and sample time in words."""
        time = f"{self.dt:g} s" if self.dt else "continuous"
        return f"{self.n_outputs} x {self.n_inputs}, {self.order} state{'s' * (self.order != 1)}, {time}"

    def poles(self) -> ComplexMatrix:
        """Return the eigenvalues of `A`, (n,) [rad/s], or [-] in discrete time."""
        return np.asarray(scipy.linalg.eigvals(self.A) if self.order else np.empty(0), dtype=np.complex128)

    def zeros(self) -> ComplexMatrix:
        """Return the finite zeros of a system with as many outputs as inputs, (k,) [rad/s], or [-] in discrete time."""
        pencil = np.block([[self.A, self.B], [self.C, self.D]])
        found = scipy.linalg.eigvals(pencil, np.diag([1.0] * self.order + [0.0] * self.n_inputs))
        return np.asarray(found[np.isfinite(found)], dtype=np.complex128)

    def is_stable(self) -> bool:
        """Return whether every pole is strictly inside the stability region."""
        poles = self.poles()
        return bool(np.all(np.abs(poles) < 1.0) if self.dt else np.all(poles.real < 0.0))

    def response(self, omega: ArrayLike) -> ComplexMatrix:
        """Return the frequency response, (k, p, m), at the k frequencies `omega` [rad/s]."""
        frequencies = np.atleast_1d(np.asarray(omega, dtype=np.float64))
        points = np.exp(1j * frequencies * self.dt) if self.dt else 1j * frequencies
        return self.transfer(np.asarray(points, dtype=np.complex128))

    def transfer(self, points: ComplexMatrix) -> ComplexMatrix:
        """Return the transfer matrix, (k, p, m), at k complex values `points` of s, or of z if discrete."""
        if not self.order:
            return np.broadcast_to(self.D.astype(np.complex128), (points.size, *self.D.shape)).copy()
        pencil = np.broadcast_to(-self.A, (points.size, *self.A.shape)).astype(np.complex128)
        pencil.reshape(points.size, self.order**2)[:, :: self.order + 1] += points[:, None]
        return np.asarray(self.C @ np.linalg.solve(pencil, self.B[None].astype(np.complex128)) + self.D)

    def subsystem(self, outputs: slice | list[int], inputs: slice | list[int]) -> "Lti":
        """Return the system from the selected inputs to the selected outputs, in that order, with all its states."""
        return Lti(A=self.A, B=self.B[:, inputs], C=self.C[outputs], D=self.D[outputs][:, inputs], dt=self.dt)

    def drop_unconnected(self) -> "Lti":
        """Return the system without the states that no input reaches, or that no output sees, by their zeros alone."""
        links = self.A != 0.0
        reached, seen = np.any(self.B != 0.0, axis=1), np.any(self.C != 0.0, axis=0)
        for _ in range(self.order):
            reached, seen = reached | links @ reached, seen | seen @ links
        at = np.flatnonzero(reached & seen)
        return Lti(A=self.A[np.ix_(at, at)], B=self.B[at], C=self.C[:, at], D=self.D, dt=self.dt)

    def __neg__(self) -> "Lti":
        return Lti(A=self.A, B=self.B, C=-self.C, D=-self.D, dt=self.dt)

    def to_control(self, **names: list[str]) -> "control.StateSpace":
        """Return a `control.StateSpace` copy; `names` are its `inputs`, `outputs` and `states`."""
        import control  # takes seconds and loads matplotlib: imported on use only

        dt = self.dt if self.order or self.dt else None  # of a gain python-control takes any sample time then
        return control.StateSpace(
            self.A.copy(), self.B.copy(), self.C.copy(), self.D.copy(), dt, remove_useless_states=False, **names
        )


def all_or_none(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of signals if each has one, else none: python-control names all signals or numbers them."""
    return tuple(names) if all(names) else ()


def signal_names(system: Any) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of the inputs and of the outputs of a system of python-control, or of an uncertain one.

    A signal that nobody has named has the empty name.
    """
    kinds = (("input_labels", "inputs"), ("output_labels", "outputs"))
    labels = (getattr(system, given, getattr(system, ours, ())) for given, ours in kinds)
    known = (names if isinstance(names, (tuple, list)) else () for names in labels)  # scipy has numbers there
    inputs, outputs = (tuple("" if _UNNAMED.fullmatch(name) else name for name in names) for names in known)
    return inputs, outputs


def as_lti(system: LinearSystem) -> Lti:
    """Return a read-only copy of `system`; a transfer function of python-control gets states first.

    A continuous system of scipy has the `dt` `None`. Of python-control that means an unspecified time base, which only
    a gain without states may have.

    Raises
    ------
    ValueError
        If the system is discrete with no sample time (python-control's `dt=True`), or unspecified (`dt=None`). Also if
        its arrays are not sound, or it is an improper transfer function, or no linear system.
    """
    if isinstance(system, Lti):
        return system
    if not hasattr(system, "A"):
        system = _give_states(system)
    if system.dt is None and hasattr(system, "isctime") and np.size(system.A):
        raise ValueError("dt of the system is None: give 0 for continuous time, or the sample time in seconds")
    if system.dt is True:
        raise ValueError("the system is discrete without a sample time; give dt in seconds")
    return Lti(A=system.A, B=system.B, C=system.C, D=system.D, dt=0.0 if system.dt is None else float(system.dt))


def _give_states(system: Any) -> Any:
    """Return the state space of a transfer function."""
    if hasattr(system, "substitute"):
        raise ValueError("an uncertain system is a family: take a member by substitute, or robstab, wcgain, wcmargin")
    if not hasattr(system, "num"):
        raise ValueError(f"{type(system).__name__} is no linear system: take a state space or a transfer function")
    return give_states(system)


def as_controller(K: LinearSystem | ArrayLike, dt: float) -> Lti:
    """Return a read-only copy of a controller; a number or matrix is a gain with the sample time `dt` [s]."""
    return as_lti(cast(LinearSystem, K)) if hasattr(K, "dt") or hasattr(K, "A") else gain(K, dt)


def as_continuous(name: str, system: LinearSystem) -> Lti:
    """Return a read-only copy of a continuous `system`.

    Raises
    ------
    ValueError
        If the system is discrete, or its arrays are not sound.
    """
    copy = as_lti(system)
    if copy.dt:
        raise ValueError(f"{name} is discrete, dt = {copy.dt} s, must be continuous")
    return copy


def gain(D: ArrayLike, dt: float = 0.0) -> Lti:
    """Return the static gain `D` as a system without states."""
    if np.iscomplexobj(D):
        raise ValueError("D has complex numbers, must be real")
    matrix = np.atleast_2d(np.asarray(D, dtype=np.float64))
    p, m = matrix.shape
    return Lti(A=np.zeros((0, 0)), B=np.zeros((0, m)), C=np.zeros((p, 0)), D=matrix, dt=dt)


def series(first: Lti, second: Lti) -> Lti:
    """Return the series connection, `first` feeding `second`; states of `first` come first.

    Raises
    ------
    ValueError
        If sizes or sample times do not fit.
    """
    if first.n_outputs != second.n_inputs:
        sizes = f"{first.n_outputs} x {first.n_inputs} feeds one of {second.n_outputs} x {second.n_inputs}"
        raise ValueError(f"a system of {sizes}, outputs and inputs must be as many")
    dt = _common_sample_time(first, second)
    A = np.block([[first.A, np.zeros((first.order, second.order))], [second.B @ first.C, second.A]])
    B, C = np.vstack([first.B, second.B @ first.D]), np.hstack([second.D @ first.C, second.C])
    return Lti(A=A, B=B, C=C, D=second.D @ first.D, dt=dt)


def sensitivity(L: Lti) -> Lti:
    """Return the sensitivity `(I + L)^-1` of the negative-feedback loop with the loop transfer `L`.

    Raises
    ------
    ValueError
        If `L` is not square, or the loop is not well posed: `I + L` is singular at infinite frequency.
    """
    if L.n_outputs != L.n_inputs:
        raise ValueError(f"the loop L is {L.n_outputs} x {L.n_inputs}, must be square")
    K = gain(-np.eye(L.n_inputs), L.dt)
    n = L.n_outputs
    B, D = np.hstack([np.zeros((L.order, n)), L.B]), np.block([[np.eye(n), L.D], [np.eye(n), L.D]])
    return lft(Lti(A=L.A, B=B, C=np.vstack([L.C, L.C]), D=D, dt=L.dt), K)


def largest_gain(M: Matrix) -> float:
    """Return the largest singular value of a matrix; numpy's own function takes twice as long.

    Raises
    ------
    LinAlgError
        If it did not converge, or `M` has what is no number.
    """
    _, singular, _, failed = dgesdd(M, compute_uv=0)
    if failed:
        raise np.linalg.LinAlgError("the singular values did not converge")
    return float(singular[0])


def is_singular(M: Matrix, terms: Matrix) -> bool:
    """Return whether changes of a relative 1e-12 of its terms can make a square matrix singular.

    `terms` (n, n) are the sums of the moduli of what each entry is the sum of. The answer does not depend on units:
    scaling of rows and columns does not change it.

    References
    ----------
    F. L. Bauer, Optimally scaled matrices, Numerische Mathematik 5 (1963), 73-87.
    """
    try:
        spread = np.abs(np.linalg.inv(M)) @ terms
    except np.linalg.LinAlgError:
        return True
    return not (np.isfinite(spread).all() and np.max(np.abs(np.linalg.eigvals(spread)), initial=0.0) < 1e12)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PartedPlant:
    """A generalised plant from (w, u) to (z, y) in parts, as the equations of a synthesis name them."""

    A: Matrix
    """(n, n) state to derivative."""
    B1: Matrix
    """(n, m1) w to derivative."""
    B2: Matrix
    """(n, m2) u to derivative."""
    C1: Matrix
    """(p1, n) state to z."""
    C2: Matrix
    """(p2, n) state to y."""
    D11: Matrix
    """(p1, m1) w to z."""
    D12: Matrix
    """(p1, m2) u to z."""
    D21: Matrix
    """(p2, m1) w to y."""
    D22: Matrix
    """(p2, m2) u to y."""


def part(P: Lti, n_meas: int, n_con: int) -> PartedPlant:
    """Return the parts of a generalised plant, its last outputs and inputs being measurements y and controls u."""
    p1, m1 = P.n_outputs - n_meas, P.n_inputs - n_con
    return PartedPlant(
        A=P.A,
        B1=P.B[:, :m1],
        B2=P.B[:, m1:],
        C1=P.C[:p1],
        C2=P.C[p1:],
        D11=P.D[:p1, :m1],
        D12=P.D[:p1, m1:],
        D21=P.D[p1:, :m1],
        D22=P.D[p1:, m1:],
    )


def lft(P: Lti, K: Lti) -> Lti:
    """Return the lower linear fractional transformation `F_l(P, K)`: `K` closes the last inputs and outputs of `P`.

    `K` reads the last `K.n_inputs` outputs of `P` and drives its last `K.n_outputs` inputs with positive feedback,
    `u = K y`. States of `P` come first.

    Raises
    ------
    ValueError
        If sizes or sample times do not fit, or the loop is not well posed.

    References
    ----------
    K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control, Prentice Hall 1996, section 10.1.
    """
    dt = _common_sample_time(P, K)
    if P.n_outputs < K.n_inputs or P.n_inputs < K.n_outputs:
        raise ValueError(f"K is {K.n_outputs} x {K.n_inputs}, larger than P, {P.n_outputs} x {P.n_inputs}")
    parts = part(P, K.n_inputs, K.n_outputs)
    # u = E_x x + E_k x_k + E_w w, with the feedthrough loop solved once
    E, returned = np.concatenate([K.D @ parts.C2, K.C, K.D @ parts.D21], axis=1), K.D @ parts.D22
    if returned.any():
        difference = np.eye(K.n_outputs) - returned
        if is_singular(difference, np.eye(K.n_outputs) + np.abs(K.D) @ np.abs(parts.D22)):
            raise ValueError("the loop of P and K is not well posed: I - D_K D22 is singular")
        E = np.linalg.solve(difference, E)
    n = P.order
    E_x, E_k, E_w = E[:, :n], E[:, n : n + K.order], E[:, n + K.order :]
    A = np.empty((n + K.order, n + K.order))
    A[:n, :n], A[:n, n:] = P.A + parts.B2 @ E_x, parts.B2 @ E_k
    A[n:, :n], A[n:, n:] = K.B @ (parts.C2 + parts.D22 @ E_x), K.A + K.B @ parts.D22 @ E_k
    B = np.concatenate([parts.B1 + parts.B2 @ E_w, K.B @ (parts.D21 + parts.D22 @ E_w)])
    C = np.concatenate([parts.C1 + parts.D12 @ E_x, parts.D12 @ E_k], axis=1)
    return Lti(A=A, B=B, C=C, D=parts.D11 + parts.D12 @ E_w, dt=dt)


def discretize_zoh(system: LinearSystem, dt: float) -> Lti:
    """Return the system sampled at multiples of `dt` [s], its input held between them; exact.

    References
    ----------
    C. F. Van Loan, Computing integrals involving the matrix exponential, IEEE TAC 23 (1978), 395-404.
    """
    G = as_lti(system)
    if G.dt:
        raise ValueError(f"the system is discrete already, dt = {G.dt} s")
    n, m = G.order, G.n_inputs
    exponential = scipy.linalg.expm(np.block([[G.A, G.B], [np.zeros((m, n + m))]]) * dt)
    return Lti(A=exponential[:n, :n], B=exponential[:n, n:], C=G.C, D=G.D, dt=dt)


def delay(width: int, dt: float) -> Lti:
    """Return a delay of one sample `dt` [s] on each of `width` channels."""
    identity, zero = np.eye(width), np.zeros((width, width))
    return Lti(A=zero, B=identity, C=identity, D=zero, dt=dt)


def _common_sample_time(first: Lti, second: Lti) -> float:
    """Return the sample time of two systems [s]; a gain without states has that of the other."""
    times = {system.dt for system in (first, second) if system.order or system.dt}
    if len(times) > 1:
        raise ValueError(f"sample times differ: {first.dt} s and {second.dt} s")
    return max(times, default=0.0)


def _as_matrix(value: ArrayLike, shape: tuple[int, int]) -> Matrix:
    """Return `value` as a matrix; a row, a column or an empty matrix may lack axes."""
    array = np.asarray(value, dtype=np.float64)
    lacks_axes = array.ndim < 2 or 0 in shape
    return array.reshape(shape) if lacks_axes and array.size == shape[0] * shape[1] else array
