"""A block diagram as an object, the source of both the generalised plant and its figure."""

from collections import Counter
from dataclasses import dataclass

import numpy as np
import scipy

from gustproof.robust.lti.state_space import LinearSystem, Lti, Matrix, as_continuous, as_lti


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal:
    """A line of the diagram: a vector with a name."""

    name: str
    """Short name, unique in the diagram."""
    label: str
    """Text beside the line, in mathematical type."""
    width: int
    """Number of components."""
    unit: str = ""
    """Physical unit; empty for a weighted, dimensionless signal."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Block:
    """A box of the diagram: a linear system between signals."""

    name: str
    """Short name, unique in the diagram."""
    label: str
    """Text in the box, in mathematical type."""
    system: LinearSystem
    """Continuous system; its inputs and outputs are the components of `inputs` and `outputs` in order."""
    inputs: tuple[str, ...]
    """Names of its input signals."""
    outputs: tuple[str, ...]
    """Names of its output signals."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sum:
    """A summing junction of the diagram."""

    output: str
    """Name of the output signal."""
    terms: tuple[tuple[int, str], ...]
    """Sign, +1 or -1, and name of each input signal; all have the same width."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Interconnection:
    """Blocks and sums joined by the names of signals, with the four groups of signals of a design problem.

    Every signal has exactly one source: a block, a sum, or the outside (`w` and `u`). States of `P` are those of the
    blocks in the order of `blocks`. The class is not specific to flight.

    Raises
    ------
    ValueError
        If a signal is unknown or has no or several sources, a width does not fit, or a block is discrete.
    """

    signals: tuple[Signal, ...]
    """Every signal."""
    blocks: tuple[Block, ...]
    """Every block, in the order of their states."""
    sums: tuple[Sum, ...]
    """Every summing junction."""
    w: tuple[str, ...]
    """Exogenous inputs: normalised disturbances, noises and references."""
    u: tuple[str, ...]
    """Controls."""
    z: tuple[str, ...]
    """Outputs to keep small."""
    y: tuple[str, ...]
    """Measurements."""

    def __post_init__(self) -> None:
        """Check that every signal has one source and every width fits."""
        made = Counter([*self.w, *self.u, *self._written, *(junction.output for junction in self.sums)])
        known = Counter(signal.name for signal in self.signals)
        added = [name for junction in self.sums for _, name in junction.terms]
        if unknown := sorted({*made, *self.z, *self.y, *self._read, *added} - {*known}):
            raise ValueError(f"unknown signal '{unknown[0]}'")
        for name in known:
            if made[name] != 1 or known[name] != 1:
                raise ValueError(f"signal '{name}' is made {made[name]} times, must be once")
        self._check_widths()

    def _check_widths(self) -> None:
        for block in self.blocks:
            system = as_continuous(f"block '{block.name}'", block.system)
            shape, wires = (system.n_outputs, system.n_inputs), (self.width(block.outputs), self.width(block.inputs))
            if shape != wires:
                raise ValueError(
                    f"block '{block.name}' is {shape[0]} x {shape[1]}, its signals are {wires[0]} x {wires[1]}"
                )
        for junction in self.sums:
            if {self.width((name,)) for _, name in junction.terms} != {self.width((junction.output,))}:
                raise ValueError(f"the sum that makes '{junction.output}' adds signals of different widths")

    @property
    def _read(self) -> tuple[str, ...]:
        """Names of the inputs of all blocks, in order."""
        return tuple(name for block in self.blocks for name in block.inputs)

    @property
    def _written(self) -> tuple[str, ...]:
        """Names of the outputs of all blocks, in order."""
        return tuple(name for block in self.blocks for name in block.outputs)

    def width(self, names: tuple[str, ...]) -> int:
        """Return the number of components of the named signals together."""
        return sum(signal.width for name in names for signal in self.signals if signal.name == name)

    @property
    def n_meas(self) -> int:
        """Number of measurements."""
        return self.width(self.y)

    @property
    def n_con(self) -> int:
        """Number of controls."""
        return self.width(self.u)

    def plant(self) -> Lti:
        """Return the generalised plant P, from (w, u) to (z, y)."""
        return self.system((*self.w, *self.u), (*self.z, *self.y))

    def system(self, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> Lti:
        """Return the system from external signals `inputs` (other external signals are 0) to any signals `outputs`.

        The vector `s` of all signals satisfies `s = N s + E e + S (C x + D R s)`. It is solved once for `s`; then
        `x' = A x + B R s`.

        Raises
        ------
        ValueError
            If an input is not external, or a loop of blocks without lag has no unique solution.
        """
        if inner := [name for name in inputs if name not in (*self.w, *self.u)]:
            raise ValueError(f"signal '{inner[0]}' is made inside the diagram")
        systems = [as_lti(block.system) for block in self.blocks]
        A, B, C, D = (scipy.linalg.block_diag(*(getattr(system, name) for system in systems)) for name in "ABCD")
        read, write = self._selection_matrix(self._read), self._selection_matrix(self._written).T
        total = self.width(tuple(signal.name for signal in self.signals))
        junctions = np.zeros((total, total))
        for junction in self.sums:
            for sign, name in junction.terms:
                junctions += sign * self._selection_matrix((junction.output,)).T @ self._selection_matrix((name,))
        loop = np.eye(total) - junctions - write @ D @ read
        if np.linalg.cond(loop) > 1e12:
            raise ValueError("blocks without lag form a loop that has no unique solution")
        from_state, from_input = (np.linalg.solve(loop, N) for N in (write @ C, self._selection_matrix(inputs).T))
        select = self._selection_matrix(outputs)
        reading = B @ read
        return Lti(A=A + reading @ from_state, B=reading @ from_input, C=select @ from_state, D=select @ from_input)

    def _selection_matrix(self, names: tuple[str, ...]) -> Matrix:
        """Return the matrix that selects the named signals, in order, from the vector of all signals."""
        start, offset = {}, 0
        for signal in self.signals:
            start[signal.name] = offset
            offset += signal.width
        rows = [start[name] + k for name in names for k in range(self.width((name,)))]
        return np.asarray(np.eye(offset)[rows], dtype=np.float64)
