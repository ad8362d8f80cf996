"""Uncertain linear systems as upper linear fractional transformations `F_u(M, Delta)`, and their algebra.

Every operation appends the operands and closes channels of the result. A rational function of parameters is therefore
written as for numbers. Parameters of one name are one parameter throughout. The module is not specific to flight.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import scipy
from numpy.typing import ArrayLike

from gustproof.robust.lti.bilinear import tustin
from gustproof.robust.lti.state_space import (
    LinearSystem,
    Lti,
    Matrix,
    all_or_none,
    as_lti,
    gain,
    is_singular,
    signal_names,
)
from gustproof.robust.lti.state_space import lft as close_known
from gustproof.robust.shown import Shown
from gustproof.robust.uncertain.family_plot import draw_family
from gustproof.robust.uncertain.interconnection import Interconnection, Signal
from gustproof.robust.uncertain.reduction import reduce, reduce_copies
from gustproof.robust.uncertain.uncertainty import Delta, DeltaBlock, FullBlock, RealBlock, delta_matrix

if TYPE_CHECKING:
    import control
    from matplotlib.axes import Axes

_EDGE = 1e-9
"""[-] excess over 1 of a normalised value that counts as rounding."""
_FAR = 10.0
"""Exponent of two beyond which a feedthrough is inverted in units of its own."""
_CORNERS = 10
"""Most parameters whose ranges' corners are all tried for a singular divisor."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Uncertain(Shown):
    """An uncertain system `y = F_u(M, Delta) u` (MATLAB: `uss`, `umat`).

    `M` maps `(w_Delta, u)` to `(z_Delta, y)`, and `w_Delta = Delta z_Delta` with the blocks in order, normalised. A
    matrix is a system without states. `+ - * / **` take numbers, arrays, `control.StateSpace` and
    `control.TransferFunction` on either side; `X * Y` is `X @ Y`, `Y` acts first. A system of one input and output is
    repeated for each channel of the other. Copies of a parameter that change nothing are removed, states never are.
    `X[i, j]` selects outputs and inputs, by number, slice, name, or a list of these.

    Raises
    ------
    ValueError
        If two blocks have one name, `M` has fewer channels than Delta, or a name is missing.

    Examples
    --------
    >>> from control import tf
    >>> from gustproof.robust import feedback, ureal
    >>> mass = ureal("mass", 2.0, percent=20)
    >>> loop = feedback(tf([3.0, 1.0], [1.0, 0.0, 0.0]) * (1 / mass))
    >>> print(loop)
    Uncertain: 1 output, 1 input, 2 states, continuous
    mass: real, 2 in [1.6, 2.4], occurs once
    >>> loop.substitute({"mass": 2.4}).poles().real
    array([-0.625, -0.625])
    """

    M: Lti
    """Known part, channels of Delta first."""
    blocks: tuple[DeltaBlock, ...] = ()
    """Blocks of Delta in the order of the channels of `M`."""
    inputs: tuple[str, ...] = ()
    """Names of the inputs; empty where one has none."""
    outputs: tuple[str, ...] = ()
    """Names of the outputs; empty where one has none."""

    # numpy would otherwise broadcast `matrix @ uncertain` over the elements of the matrix
    __array_ufunc__ = None

    def __post_init__(self) -> None:
        """Check names and sizes; any known system is taken for `M`."""
        object.__setattr__(self, "M", as_lti(self.M))
        names = [block.name for block in self.blocks]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"block '{twice[0]}' occurs twice")
        if self.n_inputs < 0 or self.n_outputs < 0:
            raise ValueError(f"M is {self.M.n_outputs} x {self.M.n_inputs}, Delta alone needs {self.n_z} x {self.n_w}")
        for kind, width in (("inputs", self.n_inputs), ("outputs", self.n_outputs)):
            given = tuple(getattr(self, kind)) or ("",) * width
            if len(given) != width:
                raise ValueError(f"there are {width} {kind}, but {len(given)} names: {', '.join(given)}")
            object.__setattr__(self, kind, given)

    if not TYPE_CHECKING:  # a type checker then knows which attributes there are

        def __getattr__(self, name: str) -> Any:
            """Raise an error that says where functions of python-control lead."""
            raise AttributeError(
                f"an uncertain system has no '{name}', a member has: substitute({{}}) is the nominal one. "
                "In place of control's functions take feedback, lft, append and connect of gustproof.robust"
            )

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

    def lines(self) -> list[str]:
        """Return its size, then each block."""
        sizes = ((self.n_outputs, "output"), (self.n_inputs, "input"), (self.M.order, "state"))
        counts = ", ".join(f"{size} {word}{'' if size == 1 else 's'}" for size, word in sizes)
        time = f"{self.M.dt:g} s" if self.M.dt else "continuous"
        return [f"Uncertain: {counts}, {time}", *(block.describe() for block in self.blocks)]

    def substitute(self, values: Mapping[str, Any]) -> "control.StateSpace":
        """Return the member at `values`, each in its own unit; names left out are nominal (MATLAB: `usubs`).

        The value of an `ultidyn` is a matrix, or a stable system within its bound.

        Raises
        ------
        ValueError
            If a name is unknown, a value outside its range, complex or of wrong shape, or the model has no solution.
        """
        known = {block.name: block for block in self.blocks}
        if unknown := sorted(set(values) - set(known)):
            raise ValueError(f"unknown parameter '{unknown[0]}', there are {', '.join(known)}")
        delta = {name: known[name].normalise(value) for name, value in values.items()}
        return self.member(delta).to_control(**self.labels())

    def labels(self) -> dict[str, list[str]]:
        """Return the names of inputs and outputs for python-control, where all are given."""
        kinds = {"inputs": all_or_none(self.inputs), "outputs": all_or_none(self.outputs)}
        return {kind: list(names) for kind, names in kinds.items() if names}

    def member(self, delta: Mapping[str, Any]) -> Lti:
        """Return the system at one normalised `delta`; names left out are nominal.

        Raises
        ------
        ValueError
            If a name or shape is wrong, a value is outside [-1, 1] or of norm above 1, or the model has no solution.
        """
        for name, value in delta.items():
            if np.iscomplexobj(value):
                raise ValueError(f"the normalised value of '{name}' is complex: a system has real numbers")
            if isinstance(value, Lti):
                continue
            matrix = np.atleast_2d(np.asarray(value, dtype=np.float64))
            size = float(np.linalg.norm(matrix, 2)) if np.isfinite(matrix).all() else np.inf
            if not size <= 1.0 + _EDGE:
                raise ValueError(f"the normalised value of '{name}' has the size {size:.6g}, must be at most 1")
        return self.close(delta)

    def close(self, delta: Mapping[str, Any]) -> Lti:
        """Return the system at a normalised `delta` of numbers, matrices and systems of any size, as `member` does."""
        systems = {name: value for name, value in delta.items() if isinstance(value, Lti)}
        numbers = {name: value for name, value in delta.items() if name not in systems}
        K = gain(delta_matrix(self.blocks, numbers), self.M.dt)
        if systems:
            parts = []
            for block in self.blocks:
                fixed = gain(delta_matrix((block,), {block.name: numbers[block.name]} if block.name in numbers else {}))
                parts += [systems[block.name]] * block.repeats if block.name in systems else [fixed]
            K = stack(*parts).M
        outputs, inputs = _move_last(self.M.n_outputs, range(self.n_z)), _move_last(self.M.n_inputs, range(self.n_w))
        return close_known(self.M.subsystem(outputs, inputs), K)

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

    def sample(self, count: int, seed: int) -> tuple[dict[str, Any], ...]:
        """Return `count` random values for `substitute` (MATLAB: `usample`).

        Parameters are uniform in their ranges, complex ones real; an `ultidyn` is a lag of random gain and corner.
        """
        rng = np.random.default_rng(seed)
        speeds = np.append(np.abs(self.M.poles()), 1.0)
        corners = float(np.min(speeds[speeds > 0.0])), float(np.max(speeds))
        return tuple(
            {block.name: _sample(block, rng, corners, self.M.dt) for block in self.blocks} for _ in range(count)
        )

    def grid(self, count: int) -> tuple[dict[str, float], ...]:
        """Return values for `substitute` at all combinations of `count` even steps over each real parameter's range."""
        real = [block for block in self.blocks if isinstance(block, RealBlock)]
        steps = [np.linspace(block.low, block.high, count).tolist() for block in real]
        return tuple({block.name: value for block, value in zip(real, point, strict=True)} for point in product(*steps))

    def plot_sigma(self, *, worst: "LinearSystem | None" = None, count: int = 20, ax: "Axes | None" = None) -> "Axes":
        """Return axes with the largest gain over frequency: `count` random members, the nominal one, and the `worst`.

        Draws with matplotlib, on `ax` or on new axes.
        """
        drawn = [as_lti(self.substitute(values)) for values in self.sample(count, seed=0)]
        return draw_family(drawn, self.nominal_system(), None if worst is None else as_lti(worst), ax)

    def with_names(self, *, inputs: Sequence[str] = (), outputs: Sequence[str] = ()) -> "Uncertain":
        """Return the same system with other names of its signals; kinds left out keep theirs."""
        return replace(self, inputs=names_of(inputs) or self.inputs, outputs=names_of(outputs) or self.outputs)

    def inverse(self) -> "Uncertain":
        """Return the system from y to u.

        Raises
        ------
        ValueError
            If the system is not square, or its feedthrough is singular for some member.
        """
        if self.n_inputs != self.n_outputs:
            raise ValueError(f"the system is {self.n_outputs} x {self.n_inputs}, only a square one has an inverse")
        n_z, n_w, n = self.n_z, self.n_w, self.n_inputs
        _require_inverse(self)
        # y in units in which it is about u, else 1 - D loses the digits of a small D
        unit = _far_units(np.abs(self.nominal_system().D).max(axis=1, initial=0.0))
        each = np.append(np.ones(n_z), unit)[:, None]
        M = replace(self.M, C=self.M.C / each, D=self.M.D / each)
        # closing u = u + (wanted - y) leaves y = wanted; the new output is u
        D11, D12, D21, D22 = M.D[:n_z, :n_w], M.D[:n_z, n_w:], M.D[n_z:, :n_w], M.D[n_z:, n_w:]
        zero, one, state = np.zeros((n, n)), np.eye(n), np.zeros((M.order, n))
        inner = [[D11, np.zeros((n_z, n)), D12], [np.zeros((n, n_w)), zero, one], [-D21, one, one - D22]]
        B, C = np.hstack([M.B[:, :n_w], state, M.B[:, n_w:]]), np.vstack([M.C[:n_z], state.T, -M.C[n_z:]])
        opened = Lti(A=M.A, B=B, C=C, D=np.block(inner), dt=M.dt)
        closed = close_known(opened, gain(np.eye(n), M.dt))
        each = np.append(np.ones(n_w), unit)
        closed = replace(closed, B=closed.B / each, D=closed.D / each)
        return Uncertain(M=closed, blocks=self.blocks, inputs=self.outputs, outputs=self.inputs)

    def feedback(self, K: "System" = 1.0, sign: float = -1.0) -> "Uncertain":
        """Return `feedback(self, K, sign)`; so `control.feedback` takes an uncertain system too."""
        return close(self, K, sign)

    def append(self, other: "System") -> "Uncertain":
        """Return `append(self, other)`; so `control.append` takes an uncertain system in the first place."""
        return stack(self, other)

    def update_names(self) -> None:
        """Change nothing: `control.series`, `parallel` and `append` end with it."""

    def __getitem__(self, channels: "tuple[_Channels, _Channels]") -> "Uncertain":
        if not isinstance(channels, tuple) or len(channels) != 2:
            raise TypeError("select outputs and inputs: system[outputs, inputs]")
        if any(np.asarray(each).dtype == bool for each in channels):
            raise TypeError("select outputs and inputs by number or name, not by true and false")
        out, into = _select("output", channels[0], self.outputs), _select("input", channels[1], self.inputs)
        M = self.M.subsystem(
            [*range(self.n_z), *(self.n_z + k for k in out)], [*range(self.n_w), *(self.n_w + k for k in into)]
        )
        names = {"inputs": tuple(self.inputs[k] for k in into), "outputs": tuple(self.outputs[k] for k in out)}
        return _tidy(Uncertain(M=M, blocks=self.blocks, **names))

    def __add__(self, other: "System") -> "Uncertain":
        X, Y = self, as_uncertain(other)
        if _shape(X) != _shape(Y):
            X, Y = _spread(X, _shape(Y)), _spread(Y, _shape(X))
        if _shape(X) != _shape(Y):
            raise ValueError(f"the sum of systems of {_size(X)} and {_size(Y)}: sizes must be equal")
        n, p = np.eye(X.n_inputs), np.eye(X.n_outputs)
        both = _series(_series(np.vstack([n, n]), stack(X, Y)), np.hstack([p, p]))
        return _tidy(replace(both, inputs=X.inputs, outputs=X.outputs))

    def __radd__(self, other: "System") -> "Uncertain":
        return as_uncertain(other) + self

    def __neg__(self) -> "Uncertain":
        scale = np.append(np.ones(self.n_z), -np.ones(self.n_outputs))[:, None]
        return replace(self, M=replace(self.M, C=scale * self.M.C, D=scale * self.M.D))

    def __sub__(self, other: "System") -> "Uncertain":
        return self + -as_uncertain(other)

    def __rsub__(self, other: "System") -> "Uncertain":
        return as_uncertain(other) - self

    def __matmul__(self, other: "System") -> "Uncertain":
        last, first = self, as_uncertain(other)
        if last.n_inputs != first.n_outputs:
            last, first = _repeat(last, first.n_outputs), _repeat(first, last.n_inputs)
        if last.n_inputs != first.n_outputs:
            raise ValueError(f"the product of systems of {_size(last)} and {_size(first)}: {last.n_inputs} inputs")
        return _tidy(_series(first, last))

    def __rmatmul__(self, other: "System") -> "Uncertain":
        return as_uncertain(other) @ self

    __mul__, __rmul__ = __matmul__, __rmatmul__

    def __truediv__(self, other: "System") -> "Uncertain":
        known: Any = other
        if hasattr(known, "num") and known.issiso():  # a transfer function, whose inverse alone may be proper
            return self @ as_uncertain(1 / known)
        return self @ as_uncertain(other).inverse()

    def __rtruediv__(self, other: "System") -> "Uncertain":
        return as_uncertain(other) @ self.inverse()

    def __pow__(self, exponent: int) -> "Uncertain":
        if not isinstance(exponent, (int, np.integer)):
            raise TypeError(f"the exponent is {exponent!r}, must be an integer")
        factor = self.inverse() if exponent < 0 else self
        power = as_uncertain(np.eye(self.n_inputs))
        for _ in range(abs(int(exponent))):
            power = power @ factor
        return power


Known = LinearSystem | ArrayLike
"""A known system, a matrix or a number."""
System = Uncertain | Known
"""An operand of the algebra: an uncertain or known system, a matrix or a number."""
_Channels = int | str | slice | Sequence[int | str]


def is_system(value: Any) -> bool:
    """Return whether a value is an uncertain or a known system, no number or array."""
    return isinstance(value, Uncertain) or hasattr(value, "dt")


def as_uncertain(system: Any) -> Uncertain:
    """Return a system or matrix as an `Uncertain`; one without uncertainty has no blocks."""
    if isinstance(system, Uncertain):
        return system
    if not hasattr(system, "dt"):
        if system is None or isinstance(system, str):
            raise TypeError(f"{system!r} is no system, matrix or number")
        return _as_matrix(system)
    inputs, outputs = signal_names(system)
    return Uncertain(M=as_lti(system), inputs=inputs, outputs=outputs)


def _as_matrix(entries: Any, *, transposed: bool = False) -> Uncertain:
    """Return a number, or a matrix whose entries may be uncertain numbers, as an uncertain matrix.

    With `transposed` factors of an entry act in the opposite order. Its value stays, the copies of parameters may not.
    """
    table = np.asarray(entries)
    if table.dtype != object:
        return Uncertain(M=gain(table))
    table = np.atleast_2d(table)
    p, m = table.shape
    at = {k: as_uncertain(each) for k, each in np.ndenumerate(table) if is_system(each)}
    known = np.array([0.0 if (i, j) in at else table[i, j] for i in range(p) for j in range(m)])
    if not np.issubdtype(known.dtype, np.number):
        raise TypeError(f"the matrix {entries!r} has entries that are no numbers or systems")
    matrix = Uncertain(M=gain(known.reshape(p, m)))
    for (i, j), entry in at.items():
        if _shape(entry) != (1, 1):
            raise ValueError(f"entry {i + 1}, {j + 1} of the matrix is {_size(entry)}, must be one number")
        turned = replace(entry, M=gain(entry.M.D.T)) if transposed and not entry.M.order else entry
        matrix = matrix + np.eye(p)[:, i : i + 1] @ turned @ np.eye(m)[j : j + 1]
    return matrix


def uss(A: Any, B: Any, C: Any, D: Any, dt: float = 0.0) -> Uncertain:
    """Return the system `x' = A x + B u`, `y = C x + D u` with uncertain numbers as entries (MATLAB: `ss`, `uss`).

    Parameters
    ----------
    A, B, C, D
        (n, n), (n, m), (p, n), (p, m): arrays, or lists of lists of numbers and uncertain numbers.
    dt
        [s] sample time; 0 is continuous.

    Raises
    ------
    ValueError
        If sizes do not fit, or an entry is no number.

    Examples
    --------
    >>> from gustproof.robust import ureal, uss
    >>> m, c, k = ureal("m", 3.0, percent=40), ureal("c", 1.0, percent=20), ureal("k", 2.0, percent=30)
    >>> uss([[0, 1], [-k / m, -c / m]], [[0], [1 / m]], [[1, 0]], [[0]])
    Uncertain: 1 output, 1 input, 2 states, continuous
    m: real, 3 in [1.8, 4.2], occurs once
    k: real, 2 in [1.4, 2.6], occurs once
    c: real, 1 in [0.8, 1.2], occurs once
    """
    found = [_stack(A, B, C, D, transposed=transposed) for transposed in (False, True)]
    whole, n = min(found, key=lambda each: sum(block.repeats for block in each[0].blocks))
    return system_from_matrix(whole, n, dt)


def _stack(A: Any, B: Any, C: Any, D: Any, *, transposed: bool) -> tuple[Uncertain, int]:
    """Return the matrix [A B; C D] and the number of states."""
    if not np.size(A):
        return _as_matrix(D), 0
    known = (part if hasattr(part, "blocks") else _as_matrix(part, transposed=transposed) for part in (A, B, C, D))
    a, b, c, d = known
    n, m, p = a.n_inputs, d.n_inputs, d.n_outputs
    if [_shape(part) for part in (a, b, c)] != [(n, n), (n, m), (p, n)]:
        raise ValueError(f"A is {_size(a)}, B {_size(b)}, C {_size(c)}, D {_size(d)}: sizes do not fit")
    x, u = np.split(np.eye(n + m), [n])
    dx, y = np.split(np.eye(n + p), [n], axis=1)
    return dx @ a @ x + dx @ b @ u + y @ c @ x + y @ d @ u, n


def simplify(system: Uncertain, *, accuracy: float = 1e-10) -> Uncertain:
    """Return the same uncertain system without its unreachable and unobservable states and repetitions.

    The algebra removes copies of parameters, but no states: one that is hidden may be unstable. Directions below the
    fraction `accuracy` of the largest coefficient count as absent. Responses are compared before and after; see
    `robust.uncertain.reduction.reduce`.

    Raises
    ------
    ValueError
        If `accuracy` is not between 0 and 1.

    Examples
    --------
    >>> from control import ss
    >>> from gustproof.robust import simplify, ureal
    >>> twin = ureal("gain", range=(0.8, 1.2)) * (ss(-1.0, 1.0, 1.0, 0.0) + ss(-1.0, 1.0, 1.0, 0.0))
    >>> (twin.M.order, simplify(twin).M.order)
    (2, 1)
    """
    if not np.isfinite(accuracy) or not 0.0 < accuracy < 1.0:
        raise ValueError(f"accuracy is {accuracy!r}, must be between 0 and 1")
    system = as_uncertain(system)
    found = reduce(system.M, system.blocks, accuracy=accuracy)
    return replace(system, M=found.M, blocks=found.blocks)


@overload
def append(*systems: Known) -> "control.StateSpace": ...
@overload
def append(*systems: System) -> Uncertain: ...
def append(*systems: System) -> Any:
    """Return the systems side by side, not connected (MATLAB: `append`, `blkdiag`); parameters of one name are one.

    As of `lft`, `feedback` and `connect`, the result of known systems alone is a `control.StateSpace`.

    Raises
    ------
    ValueError
        If sample times differ, a block of several channels occurs twice, or one name has two ranges.

    Examples
    --------
    >>> import numpy as np
    >>> from control import ss
    >>> from gustproof.robust import append, musyn, ureal
    >>> lag = ss(-0.1, [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 0.2], [0, 0.1, 0]])
    >>> plant = lag * append(np.eye(2), ureal("gain", range=(0.5, 1.5)))  # of the control alone
    >>> (plant.n_outputs, plant.n_inputs, musyn(plant, 1, 1, measure="l2gain").order)
    (3, 3, 1)
    """
    return as_given(stack(*systems), systems)


def stack(*systems: System) -> Uncertain:
    """Return the systems side by side as `append` does, known ones too."""
    parts = [as_uncertain(system) for system in systems]
    dt = _sample_time(parts)
    A, B, C, D = (scipy.linalg.block_diag(*(getattr(part.M, name) for part in parts)) for name in ("A", "B", "C", "D"))
    together = Lti(A=A, B=B, C=C, D=D, dt=dt)
    inputs = _put_delta_first([(part.n_w, part.n_inputs) for part in parts])
    outputs = _put_delta_first([(part.n_z, part.n_outputs) for part in parts])
    merged = _merge_blocks(together.subsystem(outputs, inputs), [block for part in parts for block in part.blocks])
    into, out = ([name for part in parts for name in getattr(part, kind)] for kind in ("inputs", "outputs"))
    return merged.with_names(inputs=into, outputs=out)


def as_given(found: Uncertain, given: Sequence[System]) -> Any:
    """Return what was found of known systems alone as python-control's, else as it is."""
    if found.blocks or any(isinstance(each, Uncertain) for each in given):
        return found
    return found.M.to_control(**found.labels())


def _sample_time(parts: Sequence[Uncertain]) -> float:
    times = {part.M.dt for part in parts if part.M.order or part.M.dt}
    if len(times) > 1:
        shown = " and ".join(f"{time:g} s" if time else "continuous" for time in sorted(times))
        raise ValueError(f"sample times differ: {shown}")
    return max(times, default=0.0)


@overload
def lft(P: Known, K: Known, n_y: int | None = None, n_u: int | None = None) -> "control.StateSpace": ...
@overload
def lft(P: System, K: System, n_y: int | None = None, n_u: int | None = None) -> Uncertain: ...
def lft(P: System, K: System, n_y: int | None = None, n_u: int | None = None) -> Any:
    """Return two systems with signals joined: `K` closes the last channels of `P`, or `P` the first of `K`.

    The last `n_y` outputs of `P` are the first inputs of `K`; the first `n_u` outputs of `K` are the last inputs of
    `P`. Without numbers, the smaller system is joined whole: a controller as `K`, or a Delta as `P`. Otherwise it is
    the star product. `K` acts with positive feedback.

    Raises
    ------
    ValueError
        If sizes or sample times do not fit, or the loop is not well posed at the nominal point.

    References
    ----------
    K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control, Prentice Hall 1996, section 10.4.

    Examples
    --------
    >>> from control import ss
    >>> from gustproof.robust import append, lft, ureal
    >>> plant = ss(-1.0, [[1.0, 1.0]], [[1.0], [1.0]], 0.0) * append(1.0, ureal("gain", range=(0.8, 1.2)))
    >>> lft(plant, -4.0).substitute({}).poles().real
    array([-5.])
    """
    return as_given(join(P, K, n_y, n_u), (P, K))


def join(P: System, K: System, n_y: int | None = None, n_u: int | None = None) -> Uncertain:
    """Return two systems with signals joined as `lft` does, known ones too."""
    upper, lower = as_uncertain(P), as_uncertain(K)
    if n_y is None or n_u is None:
        whole = lower if lower.n_inputs <= upper.n_outputs and lower.n_outputs <= upper.n_inputs else upper
        n_y, n_u = _shape(lower)[::-1] if whole is lower else _shape(upper)
    if n_y > min(upper.n_outputs, lower.n_inputs) or n_u > min(lower.n_outputs, upper.n_inputs):
        raise ValueError(f"P, {_size(upper)}, and K, {_size(lower)}, have no {n_y} signals down and {n_u} up in common")
    p, m = upper.n_outputs, upper.n_inputs
    inputs = (*upper.inputs[: m - n_u], *lower.inputs[n_y:])
    outputs = (*upper.outputs[: p - n_y], *lower.outputs[n_u:])
    if not lower.blocks and (n_u, n_y) == _shape(lower):
        return Uncertain(M=close_known(upper.M, lower.M), blocks=upper.blocks, inputs=inputs, outputs=outputs)
    both = stack(upper, lower)
    # external channels come first, joined ones last: (P, K) outputs and (P, K) inputs
    n_z, n_w = both.n_z, both.n_w
    down, up = range(n_z + p - n_y, n_z + p + n_u), range(n_w + m - n_u, n_w + m + n_y)
    M = both.M.subsystem(_move_last(both.M.n_outputs, down), _move_last(both.M.n_inputs, up))
    joined = np.block([[np.zeros((n_u, n_y)), np.eye(n_u)], [np.eye(n_y), np.zeros((n_y, n_u))]])
    return Uncertain(M=close_known(M, gain(joined, M.dt)), blocks=both.blocks, inputs=inputs, outputs=outputs)


@overload
def feedback(G: Known, K: Known = 1.0, sign: float = -1.0) -> "control.StateSpace": ...
@overload
def feedback(G: System, K: System = 1.0, sign: float = -1.0) -> Uncertain: ...
def feedback(G: System, K: System = 1.0, sign: float = -1.0) -> Any:
    """Return `y = G (u + sign K y)`: negative feedback, as in MATLAB and python-control.

    A `K` of one channel acts on each of the channels of `G`.

    Raises
    ------
    ValueError
        If sizes or sample times do not fit, or the nominal loop is not well posed.

    Examples
    --------
    >>> from control import tf
    >>> from gustproof.robust import feedback, ureal
    >>> loop = feedback(ureal("gain", 2.0, percent=50) * tf(1, [1, 1]))
    >>> loop.substitute({"gain": 3.0}).poles().real
    array([-4.])
    """
    return as_given(close(G, K, sign), (G, K))


def close(G: System, K: System, sign: float) -> Uncertain:
    """Return the loop of `feedback`, of known systems too."""
    if not isinstance(sign, (int, float, np.number)):
        raise TypeError(f"the sign of the feedback is {sign!r}, must be -1 or 1")
    plant, K = as_uncertain(G), as_uncertain(K)
    controller = _repeat(K, plant.n_outputs) if plant.n_inputs == plant.n_outputs else K
    if _shape(controller) != _shape(plant)[::-1]:
        raise ValueError(f"the feedback of {_size(plant)} by {_size(K)}: must be {plant.n_inputs} x {plant.n_outputs}")
    D_G, D_K = plant.nominal_system().D, sign * controller.nominal_system().D
    if is_singular(np.eye(len(D_K)) - D_K @ D_G, np.eye(len(D_K)) + np.abs(D_K) @ np.abs(D_G)):
        raise ValueError("the feedback is not well posed: its loop without lag has no unique solution")
    p, m = np.eye(plant.n_outputs), np.eye(plant.n_inputs)
    doubled = _series(_series(np.hstack([m, m]), plant), np.vstack([p, p]))
    closed = join(doubled, sign * controller, plant.n_outputs, plant.n_inputs)
    return _tidy(replace(closed, inputs=plant.inputs, outputs=plant.outputs))


def system_from_matrix(matrix: Uncertain, order: int, dt: float = 0.0) -> Uncertain:
    """Return the system whose `[A B; C D]` is the uncertain `matrix`; its first `order` channels are x' and x."""
    if matrix.M.order or matrix.M.dt:
        raise ValueError("the matrix has states or a sample time of its own")
    D, z, w = matrix.M.D, matrix.n_z, matrix.n_w
    out = [*range(z), *range(z + order, D.shape[0])]
    into = [*range(w), *range(w + order, D.shape[1])]
    M = Lti(
        A=D[z : z + order, w : w + order],
        B=D[z : z + order, into],
        C=D[out, w : w + order],
        D=D[np.ix_(out, into)],
        dt=dt,
    )
    return Uncertain(M=M, blocks=matrix.blocks)


def fill_diagram(diagram: Interconnection, replaced: Mapping[str, Uncertain]) -> Uncertain:
    """Return the generalised plant, (w, u) to (z, y), of a diagram with named blocks replaced by uncertain systems.

    The channels of Delta become signals of the diagram and are joined with the plant.

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
        if any(replace(same[0], repeats=block.repeats) != block for block in same):
            raise ValueError(f"'{name}' has two meanings: {same[0].describe()}; {same[-1].describe()}")
        blocks.append(replace(same[0], repeats=sum(block.repeats for block in same)))
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


def names_of(given: Sequence[str]) -> tuple[str, ...]:
    """Return names; a text is one."""
    return (given,) if isinstance(given, str) else tuple(given)


def _shape(system: Uncertain) -> tuple[int, int]:
    return system.n_outputs, system.n_inputs


def _size(system: Uncertain) -> str:
    return f"{system.n_outputs} x {system.n_inputs}"


def _series(first: System, last: System) -> Uncertain:
    """Return `last` behind `first`, which has as many outputs as `last` has inputs."""
    first = as_uncertain(first)
    return join(first, last, first.n_outputs, 0)


def _repeat(system: Uncertain, count: int) -> Uncertain:
    """Return a system of one channel for each of `count` channels, any other as it is."""
    return stack(*[system] * count) if _shape(system) == (1, 1) else system


def _spread(system: Uncertain, shape: tuple[int, int]) -> Uncertain:
    """Return a system of one channel from all inputs to all outputs of a `shape`, any other as it is."""
    if _shape(system) != (1, 1):
        return system
    return _series(_series(np.ones((1, shape[1])), system), np.ones((shape[0], 1)))


def _tidy(system: Uncertain) -> Uncertain:
    """Return the system without the copies of a block that change nothing."""
    if all(block.repeats == 1 for block in system.blocks):
        return system
    found = reduce_copies(system.M, system.blocks)
    return replace(system, M=found.M, blocks=found.blocks)


def _require_inverse(system: Uncertain) -> None:
    """Raise if the feedthrough is singular at the nominal point, or beyond it on the way to a corner of the ranges."""
    nominal = system.nominal_system().D
    named = ", ".join(f"'{block.name}'" for block in system.blocks) or "numbers"
    if is_singular(nominal, np.abs(nominal)):
        raise ValueError(f"no inverse: the nominal feedthrough of the system of {named} is singular")
    real = {block.name: block for block in system.blocks if isinstance(block, RealBlock)}
    still = replace(system, M=gain(system.M.D))
    for corner in _corners(list(real)):
        with suppress(ValueError):  # a model without a solution there says nothing of an inverse
            D = still.member(corner).D
            if is_singular(D, np.abs(D) + np.abs(nominal)) or np.linalg.det(D) * np.linalg.det(nominal) < 0.0:
                named = ", ".join(f"'{name}' in [{real[name].low:g}, {real[name].high:g}]" for name in corner)
                break
    else:
        return
    raise ValueError(f"no inverse: the feedthrough is singular for some {named}")


def _far_units(sizes: Matrix) -> Matrix:
    """Return powers of two next to sizes that are far from 1, and 1 for the others."""
    exponents = np.rint(np.log2(np.where(sizes > 0.0, sizes, 1.0)))
    return np.asarray(np.exp2(np.where(np.abs(exponents) > _FAR, exponents, 0.0)), dtype=np.float64)


def _corners(names: list[str]) -> list[dict[str, float]]:
    """Return the ends of each range alone, then all combinations unless they are too many."""
    ends = [{name: end} for name in names for end in (-1.0, 1.0)]
    if not 1 < len(names) <= _CORNERS:
        return ends
    return ends + [dict(zip(names, signs, strict=True)) for signs in product((-1.0, 1.0), repeat=len(names))]


def _select(kind: str, chosen: _Channels, names: tuple[str, ...]) -> list[int]:
    """Return the numbers of the chosen channels."""
    if isinstance(chosen, slice):
        return list(range(len(names)))[chosen]
    found = []
    for each in [chosen] if isinstance(chosen, (int, str, np.integer)) else chosen:
        if isinstance(each, str):
            same = [k for k, name in enumerate(names) if name == each or name.startswith(f"{each}[")]
            if not each or not same:
                raise KeyError(f"no {kind} is named '{each}', there are {', '.join(filter(None, names)) or 'no names'}")
            found += same
        else:
            if not -len(names) <= each < len(names):
                raise IndexError(f"{kind} {each} of a system that has {len(names)}")
            found.append(int(each) % len(names))
    return found


def _sample(block: DeltaBlock, rng: np.random.Generator, corners: tuple[float, float], dt: float) -> Any:
    """Return a random value of a block in its own unit; dynamics are a lag with a corner between `corners` [rad/s]."""
    if isinstance(block, RealBlock):
        return float(rng.uniform(block.low, block.high))
    size = block.bound * float(rng.uniform())
    if not block.is_dynamic:
        return block.nominal + float(rng.choice((-1.0, 1.0))) * size
    matrix = rng.normal(size=(block.n_outputs, block.n_inputs))
    matrix *= size / np.linalg.norm(matrix, 2)
    n = block.n_inputs
    pole = float(np.exp(rng.uniform(*np.log(corners))))
    # an all-pass: the gain is that of the matrix at all frequencies, the phase turns at the pole
    A, step = -pole * np.eye(n), np.eye(n)
    lag = Lti(A=A, B=np.sqrt(2.0 * pole) * step, C=-np.sqrt(2.0 * pole) * step, D=step)
    known = tustin(lag, dt) if dt else lag
    return Lti(A=known.A, B=known.B, C=matrix @ known.C, D=matrix @ known.D, dt=dt).to_control()
