"""The structure of a controller: named tunable blocks, each between some measurements and some controls.

A controller of order n is one matrix `M = [A, B; C, D]`, from (states, measurements) to (state derivatives, controls).
Every block here is affine in its parameters: an offset plus one matrix for each parameter.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from gustproof.robust.lti.bilinear import bilinear_transform, tustin
from gustproof.robust.lti.state_space import Lti, Matrix

Draw = Callable[[np.random.Generator], Matrix]
"""Function that returns random initial parameters, `(size,)`."""
Fit = Callable[[Lti], Matrix | None]
"""Function that returns parameters, `(size,)`, near a given system; `None` if the block has no fit."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TunableBlock:
    """A block of a controller, affine in its parameters; created by `tunable_ss`, `tunable_pid` and others."""

    name: str
    """Name, unique in the structure."""
    inputs: tuple[int, ...]
    """Indices of its measurements, from 0."""
    outputs: tuple[int, ...]
    """Indices of the controls it adds to, from 0."""
    order: int
    """Number of states."""
    offset: Matrix
    """(order + outputs, order + inputs) [A, B; C, D] with all parameters 0."""
    basis: Matrix
    """(size, order + outputs, order + inputs) derivative with respect to each parameter."""
    draw: Draw
    """Random initial parameters."""
    fit: Fit
    """Parameters near a given system."""
    dt: float | None = None
    """[s] sample time that its numbers hold for, 0 if continuous; `None` for any."""

    @property
    def size(self) -> int:
        """Number of parameters."""
        return int(self.basis.shape[0])

    def matrix(self, theta: Matrix) -> Matrix:
        """Return [A, B; C, D] at the parameters `theta`, (size,)."""
        return np.asarray(self.offset + np.tensordot(theta, self.basis, axes=1))

    def system(self, theta: Matrix, dt: float = 0.0) -> Lti:
        """Return the block as a system at the parameters `theta`, (size,), and the sample time `dt` [s]."""
        return _system(self.matrix(theta), self.order, dt)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Structure:
    """A controller as the sum of its blocks; its states are those of the blocks in order.

    Raises
    ------
    ValueError
        If a name occurs twice, a block names a measurement or control that does not exist, or it is written for
        another sample time.

    Examples
    --------
    >>> from gustproof import Structure, tunable_pid
    >>> pid = tunable_pid("roll", input=0, output=0, cutoff=50.0)
    >>> structure = Structure(n_meas=1, n_con=1, blocks=(pid,))
    >>> (structure.order, structure.size)
    (2, 3)
    """

    blocks: tuple[TunableBlock, ...]
    """The tunable blocks."""
    n_meas: int
    """Number of measurements."""
    n_con: int
    """Number of controls."""
    dt: float = 0.0
    """[s] sample time; 0 if continuous."""

    def __post_init__(self) -> None:
        """Check names and ports."""
        names = [block.name for block in self.blocks]
        if len(set(names)) != len(names) or not names:
            raise ValueError(f"blocks are named {', '.join(names) or '(none)'}: each needs a unique name")
        for block in self.blocks:
            for ports, count, kind in (
                (block.inputs, self.n_meas, "measurement"),
                (block.outputs, self.n_con, "control"),
            ):
                if wrong := [port for port in ports if not 0 <= port < count]:
                    raise ValueError(f"block '{block.name}' has {kind} {wrong[0]}, there are {count}, counted from 0")
            if block.dt not in (None, self.dt):
                raise ValueError(f"block '{block.name}' has the sample time {block.dt} s, the structure {self.dt} s")

    @property
    def order(self) -> int:
        """Number of states."""
        return sum(block.order for block in self.blocks)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return sum(block.size for block in self.blocks)

    def basis(self) -> tuple[Matrix, Matrix]:
        """Return offset, (r, c), and basis, (size, r, c), of the whole controller's [A, B; C, D]."""
        shape = (self.order + self.n_con, self.order + self.n_meas)
        offset, basis = np.zeros(shape), np.zeros((self.size, *shape))
        state = parameter = 0
        for block in self.blocks:
            states = range(state, state + block.order)
            rows = [*states, *(self.order + k for k in block.outputs)]
            columns = [*states, *(self.order + k for k in block.inputs)]
            offset[np.ix_(rows, columns)] += block.offset
            basis[np.ix_(range(parameter, parameter + block.size), rows, columns)] = block.basis
            state, parameter = state + block.order, parameter + block.size
        return offset, basis

    def controller(self, theta: Matrix) -> Lti:
        """Return the controller at the parameters `theta`, (size,)."""
        offset, basis = self.basis()
        return _system(offset + np.tensordot(theta, basis, axes=1), self.order, self.dt)

    def systems(self, theta: Matrix) -> dict[str, Lti]:
        """Return each block as a system, by its name."""
        ends = np.cumsum([block.size for block in self.blocks])[:-1]
        parts = np.split(theta, ends)
        return {block.name: block.system(part, self.dt) for block, part in zip(self.blocks, parts, strict=True)}

    def draw(self, rng: np.random.Generator) -> Matrix:
        """Return random parameters, (size,); blocks of a sampled structure are shrunk until they are stable."""
        theta = np.concatenate([block.draw(rng) for block in self.blocks])
        if self.dt and self.order:
            theta /= 1.0 + float(np.max(np.abs(self.controller(theta).poles())))
        return theta

    def fit(self, K: Lti) -> Matrix | None:
        """Return parameters with each block near its part of `K`; `None` if a block has no fit."""
        parts = []
        for block in self.blocks:
            rows, columns = list(block.outputs), list(block.inputs)
            part = block.fit(Lti(A=K.A, B=K.B[:, columns], C=K.C[rows], D=K.D[np.ix_(rows, columns)], dt=K.dt))
            if part is None:
                return None
            parts.append(part)
        return np.concatenate(parts)


def full_structure(order: int, n_meas: int, n_con: int, *, dt: float = 0.0) -> Structure:
    """Return the unrestricted structure: any controller of the given order; 0 is static."""
    block = tunable_ss("K", order, inputs=tuple(range(n_meas)), outputs=tuple(range(n_con)))
    return Structure(blocks=(block,), n_meas=n_meas, n_con=n_con, dt=dt)


def decoupled_structure(order: int, n_meas: int, n_con: int) -> Structure:
    """Return one block of the given order for each control k, from the measurements k, k + n_con, ...

    Raises
    ------
    ValueError
        If the number of measurements is not a multiple of the number of controls.
    """
    if n_meas % n_con:
        raise ValueError(f"{n_meas} measurements can't be shared out among {n_con} controls")
    if order >= 2 and n_meas == n_con:  # a search with few parameters gets further than with every entry free
        return observer_structure(order, n_con, leak=0.0)
    blocks = tuple(
        tunable_ss(f"K{k + 1}", order, inputs=tuple(range(k, n_meas, n_con)), outputs=(k,)) for k in range(n_con)
    )
    return Structure(blocks=blocks, n_meas=n_meas, n_con=n_con)


def tunable_gain(name: str, *, inputs: tuple[int, ...], outputs: tuple[int, ...]) -> TunableBlock:
    """Return a static gain matrix with every entry free.

    Examples
    --------
    >>> from gustproof import tunable_gain
    >>> tunable_gain("mix", inputs=(0, 1, 2), outputs=(0,)).order
    0
    """
    return tunable_ss(name, 0, inputs=inputs, outputs=outputs)


def tunable_ss(
    name: str, order: int, *, inputs: tuple[int, ...], outputs: tuple[int, ...], strictly_proper: bool = False
) -> TunableBlock:
    """Return a system with every entry of A, B, C and D free; D = 0 if `strictly_proper`.

    Examples
    --------
    >>> from gustproof import tunable_ss
    >>> tunable_ss("filter", 2, inputs=(0,), outputs=(0,)).size
    9
    """
    if order < 0:
        raise ValueError(f"order is {order}, must be 0 or more")
    p, m = len(outputs), len(inputs)
    free = np.ones((order + p, order + m), dtype=bool)
    if strictly_proper:
        free[order:, order:] = False

    def draw(rng: np.random.Generator) -> Matrix:
        M = rng.normal(size=free.shape)
        M[:order, :order] -= (1.0 + np.max(np.linalg.eigvals(M[:order, :order]).real, initial=0.0)) * np.eye(order)
        return M[free]

    def fit(K: Lti) -> Matrix:
        return _matrix(balanced_truncation(K, order))[free]

    offset, basis = np.zeros(free.shape), _unit_matrices(free)
    return TunableBlock(
        name=name, inputs=inputs, outputs=outputs, order=order, offset=offset, basis=basis, draw=draw, fit=fit
    )


def tunable_pid(name: str, *, input: int, output: int, cutoff: float, dt: float = 0.0) -> TunableBlock:
    """Return `k_p + k_i / s + k_d s / (s / cutoff + 1)`, parameters `(k_p, k_i, k_d)`; `cutoff` [rad/s] is fixed.

    With a sample time `dt` [s] the integral is Euler's sum, and the low-pass of the derivative is exact for a held
    error.

    Examples
    --------
    >>> from gustproof import tunable_pid
    >>> tunable_pid("roll", input=0, output=0, cutoff=50.0).order
    2
    """
    if not (np.isfinite(cutoff) and cutoff > 0.0):
        raise ValueError(f"cutoff is {cutoff!r}, must be positive")
    offset, basis = np.zeros((3, 3)), np.zeros((3, 3, 3))
    # states: integral of the error, and the low-passed error e_f; the derivative is cutoff (e - e_f)
    offset[0, 2], offset[1, 1], offset[1, 2] = 1.0, -cutoff, cutoff
    if dt:
        kept = np.exp(-cutoff * dt)
        offset[0, 0], offset[0, 2], offset[1, 1], offset[1, 2] = 1.0, dt, kept, 1.0 - kept
    basis[0, 2, 2] = basis[1, 2, 0] = 1.0
    basis[2, 2, 1], basis[2, 2, 2] = -cutoff, cutoff

    def draw(rng: np.random.Generator) -> Matrix:
        return rng.normal(size=3) * [1.0, 1.0, 1.0 / cutoff]

    return TunableBlock(
        name=name,
        inputs=(input,),
        outputs=(output,),
        order=2,
        offset=offset,
        basis=basis,
        draw=draw,
        fit=lambda _: None,
        dt=dt,
    )


def tunable_observer(name: str, order: int, *, input: int, output: int, leak: float) -> TunableBlock:
    """Return a system with estimates of an attitude and of its measured rate as the first two states.

    `E' = -leak E + omega`, `omega' = -b (omega - y) + a_1 E + a_2 x`, the rest free. Except for degenerate ones, every
    system of this order has this form in suitable coordinates, so nothing is lost. A law can replace the first row by
    the exact kinematics `T(E) omega` of its own estimate: it is then self-scheduled.

    Raises
    ------
    ValueError
        If `order` is below 2, without room for attitude and rate.
    """
    if order < 2:
        raise ValueError(f"order is {order}, must be 2 or more: the states are attitude, rate and others")
    offset = np.zeros((order + 1, order + 1))
    offset[0, :2] = -leak, 1.0
    free = np.ones(offset.shape, dtype=bool)
    free[0] = free[1, order] = False
    basis = _unit_matrices(free)
    basis[:, 1, order] = -basis[:, 1, 1]  # the rate estimate converges to the measured rate

    def draw(rng: np.random.Generator) -> Matrix:
        M = rng.normal(size=offset.shape)
        M[1, 1] = -rng.lognormal(mean=2.0)
        M[2:order, 2:order] -= (1.0 + np.linalg.norm(M[2:order, 2:order])) * np.eye(order - 2)
        return np.asarray(M[free])

    def fit(K: Lti) -> Matrix | None:
        M = _observer_coordinates(balanced_truncation(K, order), leak)
        return None if M is None else M[free]

    return TunableBlock(
        name=name,
        inputs=(input,),
        outputs=(output,),
        order=order,
        offset=offset,
        basis=basis,
        draw=draw,
        fit=fit,
        dt=0.0,
    )


def observer_structure(order: int, n_con: int, *, leak: float) -> Structure:
    """Return one `tunable_observer` of the given order for each control, from the rate of its own axis."""
    blocks = tuple(tunable_observer(f"K{k + 1}", order, input=k, output=k, leak=leak) for k in range(n_con))
    return Structure(blocks=blocks, n_meas=n_con, n_con=n_con)


def balanced_truncation(K: Lti, order: int) -> Lti:
    """Return a system of exactly the given order near `K`, by balanced truncation, padded if `K` is of lower order.

    An unstable `K` is shifted to a stable neighbour first; a sampled one passes through the bilinear transformation.

    References
    ----------
    K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control, Prentice Hall 1996, section 7.1.
    """
    if K.dt:
        return tustin(balanced_truncation(bilinear_transform(K), order), K.dt)
    shift = max(0.0, 1e-3 + float(np.max(K.poles().real, initial=-1.0)))
    A = K.A - shift * np.eye(K.order)
    left = _factor(scipy.linalg.solve_continuous_lyapunov(A, -K.B @ K.B.T))
    right = _factor(scipy.linalg.solve_continuous_lyapunov(A.T, -K.C.T @ K.C))
    U, sizes, Vt = np.linalg.svd(right.T @ left)
    kept = int(np.sum(sizes[:order] > 1e-10 * np.max(sizes, initial=1e-300)))
    scale = np.sqrt(sizes[:kept])
    W, T = (right @ U[:, :kept] / scale).T, left @ Vt[:kept].T / scale
    spare = order - kept
    pad = -np.eye(spare) * (1.0 + np.linalg.norm(K.A) if K.order else 1.0)
    return Lti(
        A=scipy.linalg.block_diag(W @ A @ T, pad) if spare else W @ A @ T,
        B=np.vstack([W @ K.B, np.zeros((spare, K.n_inputs))]),
        C=np.hstack([K.C @ T, np.zeros((K.n_outputs, spare))]),
        D=K.D,
    )


def _observer_coordinates(K: Lti, leak: float) -> Matrix | None:
    """Return [A, B; C, D] of the single-input `K` with states (E, E' + leak E, rest); `None` if degenerate."""
    n = K.order
    orthogonal = np.linalg.svd(K.B.T)[2][1:]
    if orthogonal.shape[0] != n - 1:
        return None
    rest = orthogonal[1:]
    E = orthogonal[0]
    omega = E @ K.A + leak * E
    T = np.vstack([E, omega, rest])
    if np.linalg.cond(T) > 1e8:
        return None
    M = _matrix(Lti(A=T @ K.A @ np.linalg.inv(T), B=T @ K.B, C=K.C @ np.linalg.inv(T), D=K.D))
    if min(abs(M[1, 1]), abs(M[1, n])) < 1e-8 * np.linalg.norm(M):
        return None
    scale = np.ones(n + 1)
    scale[:2] = -M[1, 1] / M[1, n]
    return np.asarray(scale[:, None] * M / scale)


def _unit_matrices(free: np.ndarray[tuple[int, int], np.dtype[np.bool_]]) -> Matrix:
    basis = np.zeros((int(free.sum()), *free.shape))
    basis[np.arange(basis.shape[0]), *np.nonzero(free)] = 1.0
    return basis


def _factor(gramian: NDArray[Any]) -> Matrix:
    values, vectors = np.linalg.eigh(gramian)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _matrix(K: Lti) -> Matrix:
    return np.block([[K.A, K.B], [K.C, K.D]])


def _system(M: Matrix, n: int, dt: float) -> Lti:
    return Lti(A=M[:n, :n], B=M[:n, n:], C=M[n:, :n], D=M[n:, n:], dt=dt)
