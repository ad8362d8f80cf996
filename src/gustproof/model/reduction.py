"""Reduce the repetitions and states of an uncertain system without changing its behaviour."""

from dataclasses import replace

import numpy as np

from gustproof.lti.state_space import Lti, Matrix
from gustproof.model.lft import Uncertain
from gustproof.model.uncertainty import DeltaBlock, RealBlock, columns, rows


def simplify(system: Uncertain, *, accuracy: float = 1e-10) -> Uncertain:
    """Return the same uncertain system without its unreachable and unobservable states and repetitions.

    The reachable part covers the state and every real block at once: the least set of subspaces that contains the
    images of the inputs and of each other. The observable part is the same for the transpose. The reduction is exact.
    It finds the least order when the parameters do not commute; for numbers, which do, a smaller model may exist.
    The input and output of a full block count as external. Cost: some n rounds of one singular value decomposition a
    block. Directions below the fraction `accuracy` of the largest coefficient count as absent; so scale states first
    that differ by orders of magnitude.

    References
    ----------
    R. D'Andrea, S. Khatri, Kalman decomposition of linear fractional transformation representations and minimality,
    American Control Conference 1997, 3557-3561.

    Examples
    --------
    >>> from gustproof import simplify, ureal
    >>> gain = ureal("gain", low=0.8, high=1.2)
    >>> ((gain + gain).n_w, simplify(gain + gain).n_w)
    (2, 1)
    """
    reached = _restrict(system, accuracy, dual=False)
    return _restrict(reached, accuracy, dual=True)


def _restrict(system: Uncertain, accuracy: float, *, dual: bool) -> Uncertain:
    """Return the system on its reachable subspaces, or on its observable ones (`dual`)."""
    M, n = system.M, system.M.order
    whole = np.block([[M.A, M.B], [M.C, M.D]])
    reals = [k for k, block in enumerate(system.blocks) if isinstance(block, RealBlock)]
    z = [slice(0, n), *(_shift(columns(system.blocks)[k], n) for k in reals)]
    w = [slice(0, n), *(_shift(rows(system.blocks)[k], n) for k in reals)]
    bases = _invariant_subspaces(whole.T, w, z, accuracy) if dual else _invariant_subspaces(whole, z, w, accuracy)
    left, right = _projection(whole.shape[0], z, bases), _projection(whole.shape[1], w, bases)
    smaller, order = left.T @ whole @ right, bases[0].shape[1]
    A, B, C, D = smaller[:order, :order], smaller[:order, order:], smaller[order:, :order], smaller[order:, order:]
    ranks = dict(zip(reals, (basis.shape[1] for basis in bases[1:]), strict=True))
    blocks = [_resize_block(block, ranks.get(k)) for k, block in enumerate(system.blocks)]
    kept = tuple(block for block in blocks if block is not None)
    return Uncertain(M=Lti(A=A, B=B, C=C, D=D, dt=M.dt), blocks=kept)


def _invariant_subspaces(whole: Matrix, z: list[slice], w: list[slice], accuracy: float) -> list[Matrix]:
    """Return orthonormal bases of the least subspaces V_i that contain every `M_ij V_j` and `M_ie` (e: external)."""
    inner = np.zeros(whole.shape[1], dtype=bool)
    for part in w:
        inner[part] = True
    floor = accuracy * float(np.max(np.abs(whole), initial=0.0))
    bases = [_image(whole[part][:, ~inner], floor) for part in z]
    while True:
        grown = [
            _image(np.hstack([basis, *(whole[i, j] @ V for j, V in zip(w, bases, strict=True))]), floor)
            for i, basis in zip(z, bases, strict=True)
        ]
        if all(new.shape == old.shape for new, old in zip(grown, bases, strict=True)):
            return bases
        bases = grown


def _image(matrix: Matrix, floor: float) -> Matrix:
    if not matrix.size:
        return np.zeros((matrix.shape[0], 0))
    U, s, _ = np.linalg.svd(matrix, full_matrices=False)
    return np.asarray(U[:, s > floor], dtype=np.float64)


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


def _resize_block(block: DeltaBlock, rank: int | None) -> DeltaBlock | None:
    if rank is None or not isinstance(block, RealBlock):
        return block
    return replace(block, repeats=rank) if rank else None


def _shift(part: slice, by: int) -> slice:
    return slice(part.start + by, part.stop + by)
