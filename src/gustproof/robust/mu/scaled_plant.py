"""Plants whose channels of Delta are transformed by multipliers, so that an H-infinity norm below 1 proves a level."""

from collections.abc import Sequence

import numpy as np
import scipy

from gustproof.robust.lti.state_space import Lti, Matrix, gain
from gustproof.robust.mu.minimum_phase import MinimumPhase
from gustproof.robust.uncertain.uncertain_system import Uncertain, join, stack

Factors = tuple[MinimumPhase, MinimumPhase]
"""Stable factors a and b of a multiplier `conj(b) a`, with the real part D and the imaginary part G."""


def transform(P: Lti, filters: Lti, n_z: int, n_w: int) -> Lti:
    """Return a plant with its first channels, inputs and outputs (w, z) of Delta, replaced by those of `filters`.

    `filters` maps (z, w) to new signals of the same sizes. Where the gain of the new plant from the second to the
    first is below 1, the multiplier `filters* diag(I, -I) filters` is negative on (z, w).

    Raises
    ------
    ValueError
        If the new loop is not well posed.
    """
    return join(_exchange(filters, n_z), P, n_w, n_z).M


def constant_filters(D: Sequence[Matrix], G: Sequence[Matrix]) -> Lti:
    """Return the constant filters of real D-G scalings: symmetric D > 0 and skew G of each block.

    `[D, G; G', -D]` has as many positive as negative eigenvalues, so a real T makes it `T' diag(I, -I) T`.
    """
    upper, across = scipy.linalg.block_diag(*D), scipy.linalg.block_diag(*G)
    values, vectors = np.linalg.eigh(np.block([[upper, across], [across.T, -upper]]))
    order = np.argsort(-values)
    return gain(np.sqrt(np.abs(values[order]))[:, None] * vectors[:, order].T)


def dynamic_filters(factors: Sequence[Factors], sizes: Sequence[tuple[int, int]]) -> Lti:
    """Return the filters of scalings at each frequency, one multiplier for each block of `sizes` (w, z).

    With equal factors each channel is filtered by itself. Otherwise the block is a real parameter. Its inequality
    says that (z + w) and (z - w), filtered by b and a, are passive; sum and difference of these are small in gain.
    """
    blocks = [_block_filters(pair, *size) for pair, size in zip(factors, sizes, strict=True)]
    whole = stack(*blocks).M
    firsts = np.cumsum([0, *(n_w + n_z for n_w, n_z in sizes)]).tolist()
    z = [first + k for first, (_, n_z) in zip(firsts, sizes, strict=False) for k in range(n_z)]
    w = [first + n_z + k for first, (n_w, n_z) in zip(firsts, sizes, strict=False) for k in range(n_w)]
    return whole.subsystem([*z, *w], [*z, *w])


def _block_filters(pair: Factors, n_w: int, n_z: int) -> Lti:
    a, b = pair
    if a is b:
        return stack(*[a.system()] * (n_z + n_w)).M
    apart, together = np.array([[1.0, -1.0], [1.0, 1.0]]), np.array([[0.5, 0.5], [-0.5, 0.5]])
    passive: Uncertain = together @ stack(a.system(), b.system()) @ apart
    return passive.M


def _exchange(filters: Lti, n_z: int) -> Lti:
    """Return the system from (new second output, first input) to (first output, second input) of `filters`."""
    into, out = slice(n_z, None), slice(n_z, None)
    E = np.linalg.inv(filters.D[out, into])
    seen, driven = E @ filters.C[out], filters.B[:, into] @ E
    from_z = E @ filters.D[out, :n_z]
    C = np.vstack([filters.C[:n_z] - filters.D[:n_z, into] @ seen, -seen])
    D = np.block([[filters.D[:n_z, into] @ E, filters.D[:n_z, :n_z] - filters.D[:n_z, into] @ from_z], [E, -from_z]])
    B = np.hstack([driven, filters.B[:, :n_z] - filters.B[:, into] @ from_z])
    return Lti(A=filters.A - filters.B[:, into] @ seen, B=B, C=C, D=D)
