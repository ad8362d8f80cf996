"""Reduce the repetitions and states of an uncertain system without changing its behaviour."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gustproof.robust.lti.balancing import balancing_units
from gustproof.robust.lti.norms import eigenvalues
from gustproof.robust.lti.state_space import ComplexMatrix, Lti, Matrix, gain
from gustproof.robust.uncertain.uncertainty import DeltaBlock, RealBlock, columns, rows

_CHANGED = 1e-7
"""[-] relative change of a coefficient of the response that counts as one, beside rounding."""
_ROUNDINGS = 100.0
"""[-] roundings of each term of the equations for the response, before and after."""
_POINTS = 24
"""Number of points of the complex plane at which they are compared, beside those next to poles."""
_ANGLE = 1.2
"""[rad] argument of those points."""


class Lft(NamedTuple):
    """A known part and the blocks that close its first channels."""

    M: Lti
    """Known part, channels of Delta first."""
    blocks: tuple[DeltaBlock, ...]
    """Blocks of Delta."""


def reduce(M: Lti, blocks: tuple[DeltaBlock, ...], *, accuracy: float = 1e-10) -> Lft:
    """Return the LFT without its unreachable and unobservable states and repetitions.

    The reachable part covers the state and every repeated block at once: the least set of subspaces that contains the
    images of the inputs and of each other. The observable part is the same for the transpose. It finds the least order
    when the parameters do not commute; for numbers, which do, a smaller model may exist. The input and output of a full
    block count as external.

    Directions below the fraction `accuracy` of the largest coefficient count as absent. The responses before and after
    are then compared, coefficient by coefficient, over the poles' range and at random parameters. A change by more than
    1e-7 of a coefficient, or by more than rounding, is refused. Then states and repetitions are brought to balanced
    units and each direction is compared with its own terms; what still changes a response is kept. Units do not matter.
    Cost: some n rounds of one singular value decomposition a block.

    References
    ----------
    R. D'Andrea, S. Khatri, Kalman decomposition of linear fractional transformation representations and minimality,
    American Control Conference 1997, 3557-3561.
    """
    before: Lft | None = None
    system = Lft(M, blocks)
    while system is not before:  # a smaller system has less rounding, and may let go of more
        before = system
        system = _restrict(_restrict(system, accuracy, dual=False), accuracy, dual=True)
    return system


def reduce_copies(M: Lti, blocks: tuple[DeltaBlock, ...]) -> Lft:
    """Return the LFT without repetitions that the matrix `[A B; C D]` of the parameters does without.

    States stay: what they hide may be unstable.
    """
    n, z, w = M.order, sum(block.shape[1] for block in blocks), sum(block.shape[0] for block in blocks)
    found = reduce(gain(matrix_of_parameters(M, z, w)), blocks)
    if sum(block.repeats for block in found.blocks) == sum(block.repeats for block in blocks):
        return Lft(M, blocks)
    D, z, w = found.M.D, *(sum(block.shape[axis] for block in found.blocks) for axis in (1, 0))
    into, out = [*range(w), *range(w + n, D.shape[1])], [*range(z), *range(z + n, D.shape[0])]
    A, B, C = D[z : z + n, w : w + n], D[z : z + n, into], D[out, w : w + n]
    return Lft(Lti(A=A, B=B, C=C, D=D[np.ix_(out, into)], dt=M.dt), found.blocks)


def matrix_of_parameters(M: Lti, n_z: int, n_w: int) -> Matrix:
    """Return the matrix of `M` from (w, states, inputs) to (z, derivatives, outputs), with `n_w` and `n_z` of Delta."""
    z, w = n_z, n_w
    return np.block(
        [[M.D[:z, :w], M.C[:z], M.D[:z, w:]], [M.B[:, :w], M.A, M.B[:, w:]], [M.D[z:, :w], M.C[z:], M.D[z:, w:]]]
    )


class _Equations(NamedTuple):
    """The matrix from (x, w, external inputs) to (x', z, external outputs), w and z of the reduced blocks alone."""

    whole: Matrix
    """Rows (x', z_Delta, y), columns (x, w_Delta, u), in the order of the system."""
    z: list[slice]
    """Rows of the states, then of each reduced block."""
    w: list[slice]
    """Columns of the states, then of each reduced block."""
    reals: list[int]
    """Index of each reduced block among all: parameters, and complex numbers that repeat."""


def _equations(system: Lft) -> _Equations:
    M, n = system.M, system.M.order
    whole = np.block([[M.A, M.B], [M.C, M.D]])
    reals = [k for k, block in enumerate(system.blocks) if isinstance(block, RealBlock) or block.repeats > 1]
    z = [slice(0, n), *(_shift(columns(system.blocks)[k], n) for k in reals)]
    w = [slice(0, n), *(_shift(rows(system.blocks)[k], n) for k in reals)]
    return _Equations(whole=whole, z=z, w=w, reals=reals)


def _balance(own: _Equations) -> _Equations:
    """Return the equations with each state and each repetition in a balanced unit."""
    whole, into, out = own.whole.copy(), np.concatenate(_places(own.z)), np.concatenate(_places(own.w))
    units = balancing_units(whole, [slice(i, i + 1) for i in into], [slice(j, j + 1) for j in out])
    whole[into] /= units[:, None]
    whole[:, out] *= units
    return own._replace(whole=whole)


def _restrict(system: Lft, accuracy: float, *, dual: bool) -> Lft:
    """Return the system on its reachable subspaces, or on its observable ones (`dual`); as it was if responses change.

    First, images count as rounding against the largest coefficient of all: what should cancel is then removed. In bad
    units that removes too much. So balanced units are tried next, and in these each image against its own terms.
    """
    own = _equations(system)
    balanced, samples = _balance(own), _sample(system.M, len(own.reals))
    for start, against_largest in ((own, True), (balanced, True), (balanced, False)):
        whole, z, w = start.whole, start.z, start.w
        least = float(np.max(np.abs(whole), initial=0.0)) if against_largest else 0.0
        if dual:
            bases = _invariant_subspaces(whole.T, w, z, accuracy, least)
        else:
            bases = _invariant_subspaces(whole, z, w, accuracy, least)
        ranks = [basis.shape[1] for basis in bases]
        if ranks == [_width(part) for part in w]:
            continue
        smaller = _projection(whole.shape[0], z, bases).T @ whole @ _projection(whole.shape[1], w, bases)
        found = _Equations(whole=smaller, z=_resize(z, ranks), w=_resize(w, ranks), reals=own.reals)
        if _responses_agree(start, found, samples):
            return _system(found, system, ranks)
    return system


def _system(found: _Equations, system: Lft, ranks: list[int]) -> Lft:
    """Return the equations as an uncertain system with the blocks of another, resized."""
    whole, order = found.whole, ranks[0]
    M = Lti(
        A=whole[:order, :order],
        B=whole[:order, order:],
        C=whole[order:, :order],
        D=whole[order:, order:],
        dt=system.M.dt,
    )
    repeats = dict(zip(found.reals, ranks[1:], strict=True))
    blocks = [_resize_block(block, repeats.get(k)) for k, block in enumerate(system.blocks)]
    return Lft(M, tuple(block for block in blocks if block is not None))


def _invariant_subspaces(whole: Matrix, z: list[slice], w: list[slice], accuracy: float, least: float) -> list[Matrix]:
    """Return orthonormal bases of the least subspaces V_i that contain every `M_ij V_j` and `M_ie` (e: external).

    An image leaves a subspace if that part exceeds the fraction `accuracy` of its terms' size, or of `least`.
    """
    inner = np.zeros(whole.shape[1], dtype=bool)
    for part in w:
        inner[part] = True
    outer, sizes = whole[:, ~inner], np.abs(whole)

    def extend(basis: Matrix, images: Matrix, terms: Matrix) -> Matrix:
        size = np.maximum(np.linalg.norm(terms, axis=0), least)
        images = images[:, size > 0.0] / size[size > 0.0]
        for _ in range(2):  # once leaves rounding
            images = images - basis @ (basis.T @ images)
        if not images.size:
            return basis
        U, s, _ = np.linalg.svd(images, full_matrices=False)
        return np.hstack([basis, U[:, s > accuracy][:, : len(basis) - basis.shape[1]]])

    bases = [extend(np.zeros((_width(part), 0)), outer[part], np.abs(outer[part])) for part in z]
    while True:
        grown = []
        for i, basis in zip(z, bases, strict=True):
            images = np.hstack([whole[i, j] @ V for j, V in zip(w, bases, strict=True)])
            terms = np.hstack([sizes[i, j] @ np.abs(V) for j, V in zip(w, bases, strict=True)])
            grown.append(extend(basis, images, terms))
        if all(new.shape == old.shape for new, old in zip(grown, bases, strict=True)):
            return bases
        bases = grown


class _Samples(NamedTuple):
    """Points and parameters at which responses are compared."""

    points: ComplexMatrix
    """(k,) values of s, or of z."""
    values: Matrix
    """(k, r) normalised values of r parameters, one set for each point."""


def _sample(M: Lti, n_parameters: int) -> _Samples:
    """Return points over the range of the poles and beside each of them, and parameters: nominal, then random."""
    poles = eigenvalues(M.A)
    if M.dt:
        poles = np.log(np.where(poles == 0.0, np.finfo(float).tiny, poles))
    size = np.abs(poles)
    known = size[size > 1e-12 * np.max(size, initial=0.0)]
    first, last = (0.1 * np.min(known), 10.0 * np.max(known)) if known.size else (0.1, 10.0)
    # off the axis, so that integrators and resonances leave responses finite; beside each pole, so that none hides
    spread = np.geomspace(first, last, _POINTS) * np.exp(1j * _ANGLE)
    beside = 1j * poles.imag + np.maximum(np.abs(poles.real), 0.1 * first)
    points = np.concatenate([spread, beside[poles.imag >= 0.0]])
    values = np.random.default_rng(0).uniform(-1.0, 1.0, (2 * points.size, n_parameters))
    values[: points.size] = 0.0
    points = np.exp(points) if M.dt else points
    return _Samples(points=np.concatenate([points, points]), values=values)


def _responses_agree(before: _Equations, after: _Equations, samples: _Samples) -> bool:
    """Return True if each coefficient of the external response is the same, up to rounding, at all samples."""
    for point, values in zip(samples.points, samples.values, strict=True):
        try:
            (expected, rounding), (found, more) = _response(before, point, values), _response(after, point, values)
        except np.linalg.LinAlgError:
            continue  # not well posed there
        if not np.all(np.abs(found - expected) <= _CHANGED * np.abs(expected) + rounding + more):
            return False
    return True


def _response(system: _Equations, point: complex, values: Matrix) -> tuple[ComplexMatrix, Matrix]:
    """Return the external response at a point and parameters, and a bound of the rounding of each coefficient."""
    whole, rows_in, columns_in = system.whole, np.concatenate(_places(system.z)), np.concatenate(_places(system.w))
    out = np.setdiff1d(np.arange(whole.shape[0]), rows_in)
    into = np.setdiff1d(np.arange(whole.shape[1]), columns_in)
    ranks = [_width(part) for part in system.w]
    closing = np.repeat(np.concatenate([[1.0 / point], values]), ranks)
    inner, drive, seen = (
        whole[np.ix_(rows_in, columns_in)],
        whole[np.ix_(rows_in, into)],
        whole[np.ix_(out, columns_in)],
    )
    equations = np.eye(rows_in.size) - inner * closing
    signals = np.linalg.solve(equations, drive.astype(np.complex128))
    reach = np.linalg.solve(equations.T, (seen * closing).T).T
    direct = whole[np.ix_(out, into)]
    terms = np.abs(signals) + np.abs(inner * closing) @ np.abs(signals) + np.abs(drive)
    moved = np.abs(reach) @ terms + np.abs(seen * closing) @ np.abs(signals) + np.abs(direct)
    rounding = _ROUNDINGS * np.finfo(float).eps * moved
    return direct + (seen * closing) @ signals, np.asarray(rounding, dtype=np.float64)


def _projection(size: int, parts: list[slice], bases: list[Matrix]) -> Matrix:
    """Return the identity of `size` with the columns of each part replaced by its basis."""
    identity = np.eye(size)
    kept: list[Matrix] = []
    start = 0
    for part, basis in zip(parts, bases, strict=True):
        kept.append(identity[:, start : part.start])
        kept.append(identity[:, part] @ basis)
        start = part.stop
    return np.hstack([*kept, identity[:, start:]])


def _resize(parts: list[slice], widths: list[int]) -> list[slice]:
    """Return where disjoint, ascending parts are once each has another width."""
    resized, shift = [], 0
    for part, width in zip(parts, widths, strict=True):
        resized.append(slice(part.start + shift, part.start + shift + width))
        shift += width - _width(part)
    return resized


def _resize_block(block: DeltaBlock, rank: int | None) -> DeltaBlock | None:
    if rank is None:
        return block
    return replace(block, repeats=rank) if rank else None


def _places(parts: list[slice]) -> list[NDArray[np.int64]]:
    """Return the rows or columns in each part."""
    return [np.arange(part.start, part.stop) for part in parts]


def _width(part: slice) -> int:
    return int(part.stop - part.start)


def _shift(part: slice, by: int) -> slice:
    return slice(part.start + by, part.stop + by)
