"""Robust control of fixed structure: `hinfstruct` over a growing set of worst members of an uncertain plant."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from gustproof.robust.lti.bilinear import tustin
from gustproof.robust.lti.state_space import ComplexMatrix, Lti, gain, series
from gustproof.robust.mu.sweep import Bracket
from gustproof.robust.mu.worst_gain import wcgain
from gustproof.robust.structured.blocks import Structure, full_structure
from gustproof.robust.structured.goals import NORM, Goal
from gustproof.robust.structured.hinfstruct import Progress, StructResult, check_sizes, search_problem
from gustproof.robust.structured.objective import Problem
from gustproof.robust.uncertain.uncertain_system import Uncertain, append, lft
from gustproof.robust.uncertain.uncertainty import Delta, FullBlock

_MOST_ROUNDS = 12
"""Largest number of designs, each over one worst member more."""
_PATIENCE = 2
"""Number of designs in a row without a lower certified gain after which no other follows."""
_GAIN = 1e-3
"""[-] least relative fall of the certified gain, and least excess of a new member's gain, that counts."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobustResult(StructResult):
    """A controller of fixed structure with the certified gain of its uncertain loop.

    The level `gamma` is the certified upper bound over all members, `norm` the largest gain that a member is known to
    have. `StructResult`'s record is that of the design whose controller this is.
    """

    certified: Bracket
    """Bounds on the worst gain of this controller, and the worst member."""
    corners: tuple[Delta, ...]
    """Members designed for, the nominal one first."""
    history: tuple[float, ...]
    """[-] certified gain after each design; infinite where nothing was proved."""


def robust_hinfstruct(
    P: Uncertain,
    n_meas: int,
    n_con: int,
    *,
    order: int = 0,
    structure: Structure | None = None,
    starts: int = 5,
    seed: int = 1,
    hard_goals: Sequence[Goal] = (),
    boxes: int = 1,
    progress: Progress = lambda _fraction, _text: None,
) -> RobustResult:
    """Return a controller of fixed structure with a small certified gain from w to z over an uncertain plant.

    A design for the nominal plant alone comes first. Each round bounds the worst gain of its loop by D-G scalings and
    adds the worst member found to the plants designed for. The rounds end once that member is no worse than those
    designed for, or the certified gain falls no more. The design of least certified gain is returned; with hard goals,
    the last one, which satisfies them for the most members.

    Parameters of `P` are constant in time. The worst value of a full block becomes a stable system with it at the
    frequency of the worst gain: all-passes on each side. The members are found by local search. The certified gain does
    not depend on them.

    Parameters
    ----------
    P
        Uncertain generalised plant, inputs (w, u), outputs (z, y).
    n_meas, n_con, order, structure, starts, seed, progress
        As for `hinfstruct`; designs after the first start from the one before.
    hard_goals
        Goals that every member designed for satisfies. They are not certified for the others.
    boxes
        Boxes of the real parameters for each bound on the worst gain; more are tighter and slower.

    Raises
    ------
    ValueError
        If sizes do not fit, `P` has no blocks, or an argument is out of range.
    DesignError
        If no start led to a stable loop of the nominal plant that satisfies the hard goals.

    References
    ----------
    P. Apkarian, M. N. Dao, D. Noll, Parametric robust structured control design, IEEE TAC 60 (2015), 1857-1869.
    P. Apkarian, D. Noll, Structured H-infinity control with mixed uncertainties, CDC 2016 (all-passes).

    Examples
    --------
    >>> from control import ss
    >>> from gustproof import robust_hinfstruct, ureal
    >>> plant = ss([[1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 0.1], [0, 0.1, 0]])
    >>> actuator = [[1, 0, 0], [0, 1, 0], [0, 0, 0]] + [[0], [0], [1]] @ ureal("gain", range=(0.5, 1.5)) @ [[0, 0, 1]]
    >>> result = robust_hinfstruct(plant @ actuator, n_meas=1, n_con=1, starts=1)
    >>> f"certified {result.gamma:.2f}, attained {result.norm:.2f}, {len(result.corners)} members"
    'certified 0.22, attained 0.22, 3 members'
    """
    if not P.blocks:
        raise ValueError("P has no uncertain blocks: hinfstruct is for a known plant")
    structure = full_structure(order, n_meas, n_con, dt=P.M.dt) if structure is None else structure
    corners: list[Delta] = [{}]
    models, history = [P.nominal_system()], []
    check_sizes(tuple(models), structure, n_meas, n_con, starts)
    best: tuple[StructResult, Bracket, int] | None = None
    result: StructResult | None = None
    for k in range(_MOST_ROUNDS):
        text = "" if best is None else f", certified {best[1].upper:.4g}"
        progress(k / _MOST_ROUNDS, f"{len(models)} members{text}")
        problem = Problem(models=tuple(models), structure=structure, target=NORM, hard_goals=tuple(hard_goals))
        result = search_problem(problem, starts=starts, seed=seed, near=None if result is None else result.theta)
        bracket = wcgain(lft(P, result.controller), boxes=boxes)
        history.append(bracket.upper)
        if best is None or hard_goals or bracket.upper < best[1].upper:
            best = result, bracket, k
        if bracket.lower <= (1.0 + _GAIN) * result.norm or _is_settled(history):
            break
        corners.append(bracket.delta)
        models.append(_member(P, bracket))
    progress(1.0, "certified")
    assert best is not None
    return _make_robust(*best, tuple(corners), tuple(history))


def _is_settled(history: list[float]) -> bool:
    """Return whether the last designs no longer lowered the certified gain."""
    if len(history) <= _PATIENCE or not np.isfinite(min(history)):
        return False
    return min(history) > (1.0 - _GAIN) * min(history[:-_PATIENCE])


def _make_robust(
    result: StructResult, bracket: Bracket, k: int, corners: tuple[Delta, ...], history: tuple[float, ...]
) -> RobustResult:
    record = {field.name: getattr(result, field.name) for field in fields(StructResult)}
    attained = max(result.norm, bracket.lower)
    if bracket.lower > result.norm:
        record["omega"] = bracket.omega
    proof = (
        f"D-G scalings bound the norm of every member by {bracket.upper:.6g}, between frequencies too, up to rounding."
        if np.isfinite(bracket.upper)
        else "No bound was proved: a member may be unstable."
    )
    record |= {"gamma": bracket.upper, "norm": attained, "checks": (*result.checks, proof)}
    return RobustResult(**record, certified=bracket, corners=corners[: k + 1], history=history)


def _member(P: Uncertain, worst: Bracket) -> Lti:
    """Return the member of `P` at the worst Delta, its full blocks as stable systems with their value at omega."""
    parts: list[Lti] = []
    for block in P.blocks:
        value = np.atleast_2d(worst.delta[block.name])
        if isinstance(block, FullBlock):
            parts.append(interpolate_block(value, worst.omega, P.M.dt))
        else:
            parts.append(gain(value[0, 0].real * np.eye(block.repeats), P.M.dt))
    return lft(append(*parts), P.M, P.n_w, P.n_z).M


def interpolate_block(value: ComplexMatrix, omega: float, dt: float) -> Lti:
    """Return a stable system of the norm of the complex matrix `value`, and its leading rank-one part at `omega`.

    Each entry of the leading singular vectors is an all-pass of first order with the entry's phase.

    References
    ----------
    K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control, Prentice Hall 1996, theorem 9.1 (construction).
    """
    U, sizes, Vh = np.linalg.svd(value)
    warped = 2.0 / dt * np.tan(0.5 * omega * dt) if dt else omega
    left, right = _all_passes(U[:, 0], warped), _all_passes(Vh[0], warped)
    # the channels of `right` are summed, and drive all of `left`
    joint = gain(sizes[0] * np.ones(value.shape))
    system = series(series(right, joint), left)
    return tustin(system, dt) if dt and system.order else replace(system, dt=dt)


def _all_passes(vector: ComplexMatrix, omega: float) -> Lti:
    """Return diagonal `size sign (s - a) / (s + a)` with the entries of `vector` at `omega` [rad/s]."""
    poles, levels = [], []
    for entry in vector:
        phase = float(np.angle(entry))
        level = abs(entry) if phase > 0.0 else -abs(entry)
        turn = phase if phase > 0.0 else phase + np.pi  # of (j omega - a) / (j omega + a), in (0, pi]
        poles.append(max(omega, 1e-6) * np.tan(0.5 * turn) if turn < np.pi - 1e-6 else 0.0)
        levels.append(level if poles[-1] else np.real(entry))
    a, level = np.array(poles), np.array(levels)
    kept = np.nonzero(a)[0]
    pick = np.eye(a.size)[kept]
    # (s - a) / (s + a) = 1 - 2 a / (s + a)
    return Lti(A=-np.diag(a[kept]), B=pick, C=(-2.0 * a * level * pick).T, D=np.diag(level))
