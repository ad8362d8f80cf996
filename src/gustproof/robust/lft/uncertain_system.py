"""Uncertain linear systems as upper linear fractional transformations `F_u(M, Delta)`, and their algebra.

Every operation appends the operands and closes channels of the result. A rational function of parameters is therefore
written as for numbers. Parameters of one name are one parameter throughout. The module is not specific to flight.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import ArrayLike

from gustproof.robust.lft.interconnection import Interconnection, Signal
from gustproof.robust.lft.uncertainty import Delta, DeltaBlock, FullBlock, RealBlock, delta_matrix
from gustproof.robust.lti.state_space import LinearSystem, Lti, Matrix, as_lti, gain, lft

if TYPE_CHECKING:
    import control

_EDGE = 1e-9
"""[-] excess over 1 of a normalised value that counts as rounding."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Uncertain:
    """An uncertain system `y = F_u(M, Delta) u` (MATLAB: `uss`, `umat`, `lft(Delta, M)`).

    `M` maps `(w_Delta, u)` to `(z_Delta, y)`, and `w_Delta = Delta z_Delta` with the blocks in order, normalised. A
    matrix is a system without states. `X + Y`, `X - Y`, `X @ Y` (`Y` acts first) and `-X` take systems and matrices
    too.

    Raises
    ------
    ValueError
        If two blocks have one name, or `M` has fewer channels than Delta.

    Examples
    --------
    >>> from control import ss
    >>> from gustproof import ureal
    >>> plant = ureal("gain", low=0.8, high=1.2) @ ss(-2.0, 2.0, 1.0, 0.0)
    >>> [block.name for block in plant.blocks]
    ['gain']
    """

    M: Lti
    """Known part, channels of Delta first."""
    blocks: tuple[DeltaBlock, ...] = ()
    """Blocks of Delta in the order of the channels of `M`."""

    # numpy would otherwise broadcast `matrix @ uncertain` over the elements of the matrix
    __array_ufunc__ = None

    def __post_init__(self) -> None:
        """Check names and sizes."""
        names = [block.name for block in self.blocks]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"block '{twice[0]}' occurs twice")
        if self.n_inputs < 0 or self.n_outputs < 0:
            raise ValueError(f"M is {self.M.n_outputs} x {self.M.n_inputs}, Delta alone needs {self.n_z} x {self.n_w}")

    @property
    def n_w(self) -> int:
        """Width of `w_Delta`, the outputs of Delta."""
        return sum(block.shape[0] for block in self.blocks)

    @property
    def n_z(self) -> int:
        """Width of `z_Delta`, the inputs of Delta."""
        return sum(block.shape[1] for block in self.blocks)

    @property
    def n_inputs(self) -> int:
        """Number of inputs u."""
        return self.M.n_inputs - self.n_w

    @property
    def n_outputs(self) -> int:
        """Number of outputs y."""
        return self.M.n_outputs - self.n_z

    def substitute(self, delta: Delta) -> Lti:
        """Return the system at one normalised `delta` (MATLAB: `usubs`); names left out are nominal.

        Raises
        ------
        ValueError
            If a name or shape is wrong, a value is outside [-1, 1] or of norm above 1, or the model has no solution.
        """
        for name, value in delta.items():
            if np.iscomplexobj(value):
                raise ValueError(f"the normalised value of '{name}' is complex: a system has real numbers")
            matrix = np.atleast_2d(np.asarray(value, dtype=np.float64))
            size = float(np.linalg.norm(matrix, 2)) if np.isfinite(matrix).all() else np.inf
            if not size <= 1.0 + _EDGE:
                raise ValueError(f"the normalised value of '{name}' has the size {size:.6g}, must be at most 1")
        K = gain(delta_matrix(self.blocks, delta), self.M.dt)
        outputs, inputs = _move_last(self.M.n_outputs, range(self.n_z)), _move_last(self.M.n_inputs, range(self.n_w))
        return lft(self.M.subsystem(outputs, inputs), K)

    def matrices(self, delta: Delta) -> Matrix:
        """Return the values (k, p, m) of an uncertain matrix at k deltas; each name has a value (k,) or one for all.

        Raises
        ------
        ValueError
            If the system has states or full blocks, or a name is unknown.
        """
        if self.M.order or any(isinstance(block, FullBlock) for block in self.blocks):
            raise ValueError("only a matrix of real parameters has values without frequency")
        delta_matrix(self.blocks, dict.fromkeys(delta, 0.0))  # raises for unknown names
        values = [np.asarray(delta.get(block.name, 0.0), dtype=np.float64) for block in self.blocks]
        width = np.broadcast_shapes((1,), *(value.shape for value in values))
        repeats = [block.shape[0] for block in self.blocks]
        diagonal = np.repeat([np.broadcast_to(value, width) for value in values], repeats, axis=0).T[:, :, None]
        D, z, w = self.M.D, self.n_z, self.n_w
        solved = np.linalg.solve(np.eye(z) - diagonal * D[:z, :w], diagonal * D[:z, w:])
        return D[z:, w:] + D[z:, :w] @ solved

    def nominal_system(self) -> Lti:
        """Return the system at Delta = 0."""
        return self.M.subsystem(slice(self.n_z, None), slice(self.n_w, None))

    def delta(self, values: Mapping[str, ArrayLike]) -> dict[str, Matrix]:
        """Return the normalised delta of the parameter `values`, each in its own unit; omitted names stay omitted."""
        known = {block.name: block for block in self.blocks if isinstance(block, RealBlock)}
        if unknown := sorted(set(values) - set(known)):
            raise ValueError(f"unknown parameter '{unknown[0]}', there are {', '.join(known)}")
        return {name: known[name].delta(value) for name, value in values.items()}

    def samples(self, count: int, seed: int) -> tuple[dict[str, ArrayLike], ...]:
        """Return `count` random deltas: parameters uniform in [-1, 1], full blocks real of norm 1."""
        rng = np.random.default_rng(seed)
        return tuple({block.name: _sample_block(block, rng) for block in self.blocks} for _ in range(count))

    def family(self, count: int, seed: int) -> "tuple[control.StateSpace, ...]":
        """Return `count` random members for python-control (MATLAB: `usample`)."""
        return tuple(self.substitute(delta).to_control() for delta in self.samples(count, seed))

    def inverse(self) -> "Uncertain":
        """Return the system from y to u.

        Raises
        ------
        ValueError
            If the system is not square or its nominal feedthrough is singular.
        """
        if self.n_inputs != self.n_outputs:
            raise ValueError(f"the system is {self.n_outputs} x {self.n_inputs}, only a square one has an inverse")
        M, n_z, n_w, n = self.M, self.n_z, self.n_w, self.n_inputs
        if np.linalg.cond(M.D[n_z:, n_w:]) > 1e12:
            raise ValueError("the nominal feedthrough is singular: no inverse")
        # closing u = u + (wanted - y) leaves y = wanted; the new output is u
        D11, D12, D21, D22 = M.D[:n_z, :n_w], M.D[:n_z, n_w:], M.D[n_z:, :n_w], M.D[n_z:, n_w:]
        zero, one, state = np.zeros((n, n)), np.eye(n), np.zeros((M.order, n))
        inner = [[D11, np.zeros((n_z, n)), D12], [np.zeros((n, n_w)), zero, one], [-D21, one, one - D22]]
        B, C = np.hstack([M.B[:, :n_w], state, M.B[:, n_w:]]), np.vstack([M.C[:n_z], state.T, -M.C[n_z:]])
        opened = Lti(A=M.A, B=B, C=C, D=np.block(inner), dt=M.dt)
        return Uncertain(M=lft(opened, gain(np.eye(n), M.dt)), blocks=self.blocks)

    def __add__(self, other: "Uncertain | LinearSystem | ArrayLike") -> "Uncertain":
        n, p = np.eye(self.n_inputs), np.eye(self.n_outputs)
        return np.hstack([p, p]) @ (append(self, other) @ np.vstack([n, n]))

    def __radd__(self, other: "LinearSystem | ArrayLike") -> "Uncertain":
        return as_uncertain(other) + self

    def __neg__(self) -> "Uncertain":
        return -np.eye(self.n_outputs) @ self

    def __sub__(self, other: "Uncertain | LinearSystem | ArrayLike") -> "Uncertain":
        return self + -as_uncertain(other)

    def __rsub__(self, other: "LinearSystem | ArrayLike") -> "Uncertain":
        return as_uncertain(other) - self

    def __matmul__(self, other: "Uncertain | LinearSystem | ArrayLike") -> "Uncertain":
        first = as_uncertain(other)
        return star(first, self, first.n_outputs, 0)

    def __rmatmul__(self, other: "LinearSystem | ArrayLike") -> "Uncertain":
        return as_uncertain(other) @ self


def ureal(name: str, *, low: float, high: float, nominal: float | None = None) -> Uncertain:
    """Return an uncertain real number as a 1 x 1 system (MATLAB: `ureal`); nominal is the middle unless given.

    Examples
    --------
    >>> from gustproof import ureal
    >>> gain = ureal("gain", low=0.8, high=1.2)
    >>> (gain @ gain).blocks[0].repeats
    2
    """
    block = RealBlock(name=name, low=low, high=high, nominal=0.5 * (low + high) if nominal is None else nominal)
    b, c = block.coefficients
    return Uncertain(M=gain([[-c, 1.0], [b, block.nominal]]), blocks=(block,))


def ultidyn(name: str, n_outputs: int = 1, n_inputs: int = 1) -> Uncertain:
    """Return a stable unknown system of H-infinity norm <= 1 (MATLAB: `ultidyn`).

    Examples
    --------
    >>> from gustproof import ultidyn
    >>> ultidyn("unmodelled", 2, 1).n_outputs
    2
    """
    block = FullBlock(name=name, n_outputs=n_outputs, n_inputs=n_inputs)
    passed = np.block([[np.zeros((n_inputs, n_outputs)), np.eye(n_inputs)], [np.eye(n_outputs), np.zeros(block.shape)]])
    return Uncertain(M=gain(passed), blocks=(block,))


def as_uncertain(system: "Uncertain | LinearSystem | ArrayLike") -> Uncertain:
    """Return a system or matrix as an `Uncertain`; one without uncertainty has no blocks."""
    if isinstance(system, Uncertain):
        return system
    return Uncertain(M=as_lti(system) if hasattr(system, "dt") else gain(system))  # type: ignore[arg-type]


def append(*systems: "Uncertain | LinearSystem | ArrayLike") -> Uncertain:
    """Return the systems side by side, not connected (MATLAB: `append`, `blkdiag`); parameters of one name are one.

    Raises
    ------
    ValueError
        If sample times differ, a full block occurs twice, or one parameter has two ranges.

    Examples
    --------
    >>> import numpy as np
    >>> from control import ss
    >>> from gustproof import append, musyn, ureal
    >>> lag = ss(-0.1, [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 0.2], [0, 0.1, 0]])
    >>> plant = lag @ append(np.eye(2), ureal("gain", low=0.5, high=1.5))  # of the control alone
    >>> (plant.n_outputs, plant.n_inputs, musyn(plant, 1, 1, measure="l2gain").order)
    (3, 3, 1)
    """
    parts = [as_uncertain(system) for system in systems]
    dt = _sample_time(parts)
    A, B, C, D = (scipy.linalg.block_diag(*(getattr(part.M, name) for part in parts)) for name in ("A", "B", "C", "D"))
    together = Lti(A=A, B=B, C=C, D=D, dt=dt)
    inputs = _put_delta_first([(part.n_w, part.n_inputs) for part in parts])
    outputs = _put_delta_first([(part.n_z, part.n_outputs) for part in parts])
    return _merge_blocks(together.subsystem(outputs, inputs), [block for part in parts for block in part.blocks])


def _sample_time(parts: Sequence[Uncertain]) -> float:
    times = {part.M.dt for part in parts if part.M.order or part.M.dt}
    if len(times) > 1:
        raise ValueError(f"sample times differ: {' s and '.join(str(time) for time in sorted(times))} s")
    return max(times, default=0.0)


def star(P: "Uncertain | LinearSystem", Q: "Uncertain | LinearSystem", n_y: int, n_u: int) -> Uncertain:
    """Return the star product: `P` above `Q`, joined by `n_y` signals down and `n_u` signals up (MATLAB: `lft`).

    The last `n_y` outputs of `P` are the first inputs of `Q`; the first `n_u` outputs of `Q` are the last inputs of
    `P`.

    Raises
    ------
    ValueError
        If sizes do not fit, or the loop is not well posed at the nominal point.

    References
    ----------
    K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control, Prentice Hall 1996, section 10.4.
    """
    upper, lower = as_uncertain(P), as_uncertain(Q)
    if n_y > min(upper.n_outputs, lower.n_inputs) or n_u > min(lower.n_outputs, upper.n_inputs):
        raise ValueError(f"P and Q have no {n_y} signals down and {n_u} up in common")
    both = append(upper, lower)
    # external channels come first, joined ones last: (P, Q) outputs and (P, Q) inputs
    p, m, n_z, n_w = upper.n_outputs, upper.n_inputs, both.n_z, both.n_w
    down, up = range(n_z + p - n_y, n_z + p + n_u), range(n_w + m - n_u, n_w + m + n_y)
    M = both.M.subsystem(_move_last(both.M.n_outputs, down), _move_last(both.M.n_inputs, up))
    joined = np.block([[np.zeros((n_u, n_y)), np.eye(n_u)], [np.eye(n_y), np.zeros((n_y, n_u))]])
    return Uncertain(M=lft(M, gain(joined, M.dt)), blocks=both.blocks)


def close_loop(P: Uncertain, K: LinearSystem) -> Uncertain:
    """Return the uncertain loop `F_l(P, K)`: `K` reads the last outputs of `P` and drives its last inputs.

    Raises
    ------
    ValueError
        If sizes or sample times do not fit, or the loop is not well posed.

    Examples
    --------
    >>> from control import ss
    >>> from gustproof import close_loop, ureal
    >>> plant = ureal("gain", low=0.8, high=1.2) @ ss(-1.0, 1.0, 1.0, 0.0)
    >>> close_loop(plant, ss([], [], [], -4.0)).M.poles().real
    array([-5.])
    """
    controller = as_lti(K)
    if controller.n_inputs > P.n_outputs or controller.n_outputs > P.n_inputs:
        size = f"{controller.n_outputs} x {controller.n_inputs}"
        raise ValueError(f"K is {size}, larger than P, {P.n_outputs} x {P.n_inputs}")
    return Uncertain(M=lft(P.M, controller), blocks=P.blocks)


def system_from_matrix(matrix: Uncertain, order: int) -> Uncertain:
    """Return the system whose `[A B; C D]` is the uncertain `matrix`; its first `order` channels are x' and x."""
    if matrix.M.order or matrix.M.dt:
        raise ValueError("the matrix has states or a sample time of its own")
    D, z, w = matrix.M.D, matrix.n_z, matrix.n_w
    out = [*range(z), *range(z + order, D.shape[0])]
    into = [*range(w), *range(w + order, D.shape[1])]
    M = Lti(
        A=D[z : z + order, w : w + order], B=D[z : z + order, into], C=D[out, w : w + order], D=D[np.ix_(out, into)]
    )
    return Uncertain(M=M, blocks=matrix.blocks)


def connect(diagram: Interconnection, replaced: Mapping[str, Uncertain]) -> Uncertain:
    """Return the generalised plant, (w, u) to (z, y), of a diagram with named blocks replaced by uncertain systems.

    The channels of Delta become signals of the diagram and are joined with the plant (MATLAB: `connect`).

    Raises
    ------
    ValueError
        If there is no such block, sizes do not fit, or the diagram is not well posed.
    """
    if unknown := sorted(set(replaced) - {block.name for block in diagram.blocks}):
        raise ValueError(f"the diagram has no block '{unknown[0]}'")
    signals, blocks, drives, reads = list(diagram.signals), [], [], []
    delta: list[DeltaBlock] = []
    for block in diagram.blocks:
        system = replaced.get(block.name)
        if system is None:
            blocks.append(block)
            continue
        w, z = f"{block.name}.w_Delta", f"{block.name}.z_Delta"
        signals += [Signal(name=w, label="", width=system.n_w), Signal(name=z, label="", width=system.n_z)]
        blocks.append(replace(block, system=system.M, inputs=(w, *block.inputs), outputs=(z, *block.outputs)))
        drives.append(w)
        reads.append(z)
        delta += system.blocks
    opened = replace(diagram, signals=tuple(signals), blocks=tuple(blocks), w=(*drives, *diagram.w))
    M = opened.system((*drives, *diagram.w, *diagram.u), (*reads, *diagram.z, *diagram.y))
    return _merge_blocks(M, delta)


def _merge_blocks(M: Lti, stacked: Sequence[DeltaBlock]) -> Uncertain:
    """Return `F_u(M, Delta)` with each name once; the Delta channels of `M` are in the order of `stacked`."""
    names = list(dict.fromkeys(block.name for block in stacked))
    order = sorted(range(len(stacked)), key=lambda k: names.index(stacked[k].name))
    inputs = _reorder_channels([block.shape[0] for block in stacked], order, M.n_inputs)
    outputs = _reorder_channels([block.shape[1] for block in stacked], order, M.n_outputs)
    blocks: list[DeltaBlock] = []
    for name in names:
        same = [block for block in stacked if block.name == name]
        if isinstance(same[0], RealBlock):
            if any(replace(same[0], repeats=block.shape[0]) != block for block in same):
                raise ValueError(f"parameter '{name}' has two ranges")
            same = [replace(same[0], repeats=sum(block.shape[0] for block in same))]
        blocks += same
    return Uncertain(M=M.subsystem(outputs, inputs), blocks=tuple(blocks))


def _reorder_channels(sizes: list[int], order: list[int], total: int) -> list[int]:
    """Return the channels of blocks of `sizes` in a new order of the blocks, then the others up to `total`."""
    starts = np.cumsum([0, *sizes]).tolist()
    moved = [channel for k in order for channel in range(starts[k], starts[k + 1])]
    return [*moved, *range(starts[-1], total)]


def _put_delta_first(sizes: list[tuple[int, int]]) -> list[int]:
    """Return the channels of systems side by side, each of `sizes` (Delta, external), with those of Delta first."""
    starts = np.cumsum([0, *(inner + outer for inner, outer in sizes)]).tolist()
    of_delta = [c for start, (inner, _) in zip(starts, sizes, strict=False) for c in range(start, start + inner)]
    return [*of_delta, *sorted(set(range(starts[-1])) - set(of_delta))]


def _move_last(total: int, moved: range) -> list[int]:
    """Return all channels with the `moved` ones last."""
    return [*(channel for channel in range(total) if channel not in moved), *moved]


def _sample_block(block: DeltaBlock, rng: np.random.Generator) -> ArrayLike:
    if isinstance(block, RealBlock):
        return float(rng.uniform(-1.0, 1.0))
    full = rng.normal(size=block.shape)
    return np.asarray(full / np.linalg.norm(full, 2))
