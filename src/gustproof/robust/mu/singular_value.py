"""Bounds on the structured singular value of an uncertain system over all frequencies.

The upper bound holds between frequencies too, up to the rounding of the eigenvalues that end its bands: it is no
certificate. The lower bound is a Delta that makes the loop singular. Branch and bound over real parameters brings both
together. Parameters are constant in time; certificates cover varying ones. A sampled loop of inertia and lag has a
bound without this rounding, in which one lag is one parameter: `zero_exclusion`.
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from gustproof.robust.lti.margins import largest_disk
from gustproof.robust.lti.state_space import ComplexMatrix, LinearSystem, Lti, as_lti, sensitivity
from gustproof.robust.mu.one_parameter import one_parameter_margin
from gustproof.robust.mu.sweep import Bracket, add_performance_block, sweep, to_continuous, unwarp_frequency
from gustproof.robust.mu.worst_delta import WorstDelta, most_singular_delta, most_unstable_delta, worst_delta
from gustproof.robust.mu.worst_gain import MOST_HALVED, ParameterBox, best_halves, restrict, whole_box
from gustproof.robust.uncertain.uncertain_system import Uncertain, as_uncertain
from gustproof.robust.uncertain.uncertainty import DeltaBlock, FullBlock, RealBlock, columns, rows

_HALVINGS = 40
"""Number of halvings that place the crossing of a pole on a line of parameters."""
_SAME = 1e-3
"""[-] relative difference of a gain from the inverse of its radius at which both are mu."""
_RADII = 12
"""Most radii of the other blocks at which the gain at the last one is searched."""
_NOTHING = 1e-9
"""[-] mu below which a Delta that is found owes itself to rounding."""
SHARES = (0.998, 0.99, 0.98, 0.95, 0.9, 0.8, 0.65, 0.5)
"""[-] shares of the radius of the found Delta that branch and bound tries in turn."""


def mu(system: Uncertain, *, accuracy: float = 0.02, boxes: int = 1) -> Bracket:
    """Return the peak of mu of `M` with respect to `Delta` over all frequencies (MATLAB: `mussv`, `robstab`).

    The system is stable for every Delta of norm below 1 / upper. The returned Delta, of norm 1 / lower, makes it
    singular at `omega`. A full block named "performance" closes inputs and outputs, if any. The result is then robust
    performance: below 1, the gain stays below 1 over the unit ball.

    Parameters
    ----------
    system
        Stable at Delta = 0.
    accuracy
        [-] relative distance of the upper bound from the least one of D-G scalings.
    boxes
        Largest number of boxes of the real parameters at each level tried; 1 for scalings alone.

    Raises
    ------
    ValueError
        If the system is not stable at Delta = 0, or has no blocks.

    References
    ----------
    A. Packard, J. C. Doyle, The complex structured singular value, Automatica 29 (1993), 71-109. M. P. Newlin, P. M.
    Young, Mixed mu problems and branch and bound techniques, Int. J. of Robust and Nonlinear Control 7 (1997), 145-164.

    Examples
    --------
    >>> from control import ss
    >>> from gustproof import lft, ureal
    >>> from gustproof.robust.mu.singular_value import mu
    >>> third_order = ss([[0, 1, 0], [0, 0, 1], [-1, -3, -3]], [[0], [0], [1]], [1, 0, 0], 0)
    >>> plant = ureal("gain", range=(0.5, 1.5)) * third_order
    >>> found = mu(lft(plant, -4.0))
    >>> f"{1.0 / found.lower:.2f}"  # times the spread, the gain is unstable
    '2.00'
    """
    system = as_uncertain(system)
    found = _bracket(system, accuracy)
    few = len(whole_box(system)) <= MOST_HALVED
    if boxes > 1 and few and found.gap > 2.0 * accuracy and found.lower > 0.0:
        found = replace(found, upper=_branch_and_bound(system, found, accuracy, boxes))
    return found


def _bracket(system: Uncertain, accuracy: float) -> Bracket:
    """Return the bracket by scalings over all frequencies, and by search."""
    blocks = add_performance_block(system) if system.n_inputs else system.blocks
    M = to_continuous(system)
    if len(blocks) == 1 and isinstance(blocks[0], RealBlock) and M.is_stable():
        exact = one_parameter_margin(M, blocks[0])
        if exact:
            return replace(exact, omega=unwarp_frequency(exact.omega, system))
    upper, grid = sweep(M, blocks, gain=False, accuracy=accuracy)
    if upper == 0.0 or (upper < _NOTHING and not system.n_inputs):
        return Bracket(lower=0.0, upper=upper, omega=0.0, delta={})
    if all(isinstance(block, RealBlock) for block in blocks):
        found = _realmatrix_lower_bound(M, blocks, upper)
    else:
        found = _mixed_lower_bound(M, blocks, upper, grid)
    return replace(found, omega=unwarp_frequency(found.omega, system))


def _mixed_lower_bound(M: Lti, blocks: tuple[DeltaBlock, ...], upper: float, grid: list[float]) -> Bracket:
    """Return the best lower bound at the frequencies of a grid, and where responses are real."""
    best = _real_response_lower_bound(M, blocks, upper)
    for omega in grid:
        lower, delta = matrix_lower_bound(M.response(omega)[0], blocks, upper)
        if lower > best.lower:
            best = Bracket(lower=lower, upper=upper, omega=omega, delta=delta)
    return best


def _branch_and_bound(system: Uncertain, found: Bracket, accuracy: float, boxes: int) -> float:
    """Return the least upper bound that boxes of the real parameters prove."""
    blocks = add_performance_block(system) if system.n_inputs else system.blocks
    closed = Uncertain(M=system.M, blocks=blocks)
    for share in SHARES:
        level = found.lower / share
        if level >= found.upper:
            break
        if _is_stable_within(closed, 1.0 / level, accuracy, boxes):
            return level
    return found.upper


def _is_stable_within(system: Uncertain, radius: float, accuracy: float, boxes: int) -> bool:
    """Return whether the system is proved stable for every Delta of norm `radius`, by at most `boxes` boxes."""
    whole: ParameterBox = {block.name: (-radius, radius) for block in system.blocks if isinstance(block, RealBlock)}
    pending, seen = [whole], 1
    while pending:
        box = pending.pop()
        family = restrict(system, box, radius=radius)
        M = to_continuous(family)
        if not M.is_stable():
            return False
        upper, grid = sweep(M, family.blocks, gain=False, accuracy=accuracy, wanted=1.0)
        if upper < 1.0:
            continue
        seen += 1
        if seen > boxes or not whole:
            return False
        omega = unwarp_frequency(grid[0], system)
        pending += best_halves(system, box, omega, accuracy, gain=False, radius=radius)
    return True


def disk_margin_bounds(L: LinearSystem, *, accuracy: float = 1e-3) -> tuple[float, float]:
    """Return the lower and upper bound on the multi-loop disk margin of the negative-feedback loop `L`.

    The margin is 1 / mu of `S - I/2` with one complex block per channel (MATLAB: `diskmargin`). Scalings are free at
    each frequency. No margin is above 2, which covers every positive gain. Up to `accuracy`, the bound is never below
    `robust.lti.margins.disk_margin`, whose scaling is constant.

    References
    ----------
    P. Seiler, A. Packard, P. Gahinet, An introduction to disk margins, IEEE Control Systems Magazine 40 (2020), 78-95.

    Examples
    --------
    >>> from control import ss
    >>> from gustproof.robust.mu.singular_value import disk_margin_bounds
    >>> lower, upper = disk_margin_bounds(ss([[0, 1], [0, -2]], [[0], [1]], [[2, 0]], 0))
    >>> f"{lower:.2f} to {upper:.2f}"
    '1.15 to 1.15'
    """
    S = sensitivity(as_lti(L))
    M = Lti(A=S.A, B=S.B, C=S.C, D=S.D - 0.5 * np.eye(S.n_outputs), dt=S.dt)
    channels = tuple(FullBlock(name=f"channel {k}") for k in range(S.n_outputs))
    found = mu(Uncertain(M=M, blocks=channels), accuracy=accuracy)
    return largest_disk(found.upper), largest_disk(found.lower)


def matrix_lower_bound(
    M: ComplexMatrix, blocks: tuple[DeltaBlock, ...], upper: float
) -> tuple[float, dict[str, ArrayLike]]:
    """Return a lower bound on mu of a matrix with a full block, and a Delta of norm 1 / bound that makes it singular.

    The gain at the last full block falls as the ball of the others shrinks. At gain 1 / radius, both norms are as small
    as possible. For a repeated number the gain is a spectral radius.
    """
    last = max((block.repeats == 1, k) for k, block in enumerate(blocks) if isinstance(block, FullBlock))[1]
    repeated = blocks[last].repeats > 1
    order = [*(k for k in range(len(blocks)) if k != last), last]
    z, w = (np.concatenate([np.r_[parts[k]] for k in order]) for parts in (columns(blocks), rows(blocks)))
    swapped, others = M[np.ix_(z, w)], tuple(blocks[k] for k in order[:-1])
    beta = upper if math.isfinite(upper) else float(np.linalg.norm(M, 2))
    best, delta, most = 0.0, dict[str, ArrayLike](), 2.0 * beta
    enough = (1.0 - _SAME) * upper  # no gain is larger at the first radius
    for _ in range(_RADII):
        found = worst_delta(swapped, others, radius=1.0 / beta, repeated=repeated, enough=enough)
        if min(beta, found.gain) > best:
            best = min(beta, found.gain)
            delta = {**found.parts(others), blocks[last].name: _closing_matrix(swapped, found, repeated=repeated)}
        if found.gain <= 0.0 or abs(found.gain - beta) <= _SAME * beta:
            break
        beta, most = _next_radius(beta, found.gain, best, most)
        enough = math.inf
    return best, delta


def _next_radius(beta: float, reached: float, best: float, most: float) -> tuple[float, float]:
    """Return the next inverse radius after `beta`, where the gain `reached` was met, and the least one too large."""
    most = min(most, beta) if reached < beta else most
    step = math.sqrt(beta * min(reached, 100.0 * beta))
    # near a pole of the gain such steps are too long
    return step if best < step < most else math.sqrt(best * most), most


def _closing_matrix(M: ComplexMatrix, found: WorstDelta, *, repeated: bool) -> ComplexMatrix:
    """Return the smallest matrix, or number, with which `F_u(M, Delta)` is singular in feedback; 0 if it is without."""
    Delta = found.Delta
    n_w, n_z = Delta.shape
    if math.isinf(found.gain):
        return np.zeros((M.shape[1] - n_w, M.shape[0] - n_z), dtype=np.complex128)
    loop = np.eye(n_z) - M[:n_z, :n_w] @ Delta
    seen = M[n_z:, n_w:] + M[n_z:, :n_w] @ Delta @ np.linalg.solve(loop, M[:n_z, n_w:])
    if repeated:
        return np.array([[1.0 / max(np.linalg.eigvals(seen), key=abs)]])
    U, s, Vh = np.linalg.svd(seen)
    return np.asarray(np.outer(Vh[0].conj(), U[:, 0].conj()) / s[0])


def _real_response_lower_bound(M: Lti, blocks: tuple[DeltaBlock, ...], upper: float) -> Bracket:
    """Return the lower bound from the responses of `M` that are real."""
    responses = {0.0: M.response(0.0)[0], math.inf: M.D.astype(np.complex128)}
    found = [(most_singular_delta(response, blocks), omega) for omega, response in responses.items()]
    worst, omega = max(found, key=lambda pair: pair[0].gain)
    if worst.gain == 0.0:
        return Bracket(lower=0.0, upper=upper, omega=0.0, delta={})
    smallest = WorstDelta(gain=worst.gain, Delta=worst.Delta / worst.gain)
    return Bracket(lower=worst.gain, upper=upper, omega=omega, delta=smallest.parts(blocks))


def _realmatrix_lower_bound(M: Lti, blocks: tuple[DeltaBlock, ...], upper: float) -> Bracket:
    """Return a lower bound on mu of real parameters: where `M` is real, at 0 and infinity, or where a pole crosses.

    Poles cross the axis in the smallest ball found.
    """
    best = _real_response_lower_bound(M, blocks, upper)
    if not M.order:
        return best
    inside, outside = 0.0, math.inf
    radius = 1.0 / upper if 0.0 < upper < math.inf else 1.0
    while outside > 1.001 * inside and radius < 1e3:
        found, pole = most_unstable_delta(M, blocks, radius=radius)
        if found.gain >= 0.0:
            outside = radius
            if best.lower < 1.0 / radius:
                best = Bracket(lower=1.0 / radius, upper=upper, omega=abs(pole.imag), delta=found.parts(blocks))
        else:
            inside = radius
        if math.isinf(outside):
            radius *= 1.3
        else:
            radius = math.sqrt(inside * outside) if inside else 0.5 * outside
        if outside < 1e-6:
            break
    return _refine(M, blocks, best) if 0.0 < best.omega < math.inf else best


def _refine(M: Lti, blocks: tuple[DeltaBlock, ...], found: Bracket) -> Bracket:
    """Return the lower bound from the first point on the way to its Delta at which a pole is no longer stable."""
    closed = Uncertain(M=M, blocks=blocks)
    poles, inside, outside = M.poles(), 0.5, 1.0
    for _ in range(_HALVINGS):
        share = 0.5 * (inside + outside)
        values = {name: share * np.asarray(value) for name, value in found.delta.items()}
        poles = closed.close(values).poles()
        inside, outside = (share, outside) if np.all(poles.real < 0.0) else (inside, share)
    delta = {name: float(outside * np.asarray(value)) for name, value in found.delta.items()}
    pole = poles[int(np.argmax(poles.real))]
    return replace(found, lower=min(found.lower / outside, found.upper), omega=abs(float(pole.imag)), delta=delta)
