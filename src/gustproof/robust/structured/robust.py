"""Robust control of fixed structure: `hinfstruct` over a growing set of worst members of an uncertain plant."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from gustproof.robust.mu.robust_bounds import RobustBounds
from gustproof.robust.mu.worst_gain import wcgain
from gustproof.robust.structured.blocks import Structure, full_structure
from gustproof.robust.structured.goals import NORM, Goal
from gustproof.robust.structured.hinfstruct import Progress, StructResult, check_sizes, search_problem
from gustproof.robust.structured.objective import Problem
from gustproof.robust.uncertain.interpolation import interpolate_blocks
from gustproof.robust.uncertain.uncertain_system import Uncertain, as_uncertain, lft
from gustproof.robust.uncertain.uncertainty import Delta

_MOST_ROUNDS = 12
"""Largest number of designs, each over one worst member more."""
_ACCURACY = 0.02
"""[-] relative distance of each certified gain from the least one of D-G scalings."""
_PATIENCE = 2
"""Number of designs in a row without a lower certified gain after which no other follows."""
_GAIN = 1e-3
"""[-] least relative fall of the certified gain, and least excess of a new member's gain, that counts."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class RobustResult(StructResult):
    """A controller of fixed structure with the certified gain of its uncertain loop.

    The level `gamma` is the certified upper bound over all members, `norm` the largest gain that a member is known to
    have. `StructResult`'s record is that of the design whose controller this is.
    """

    certified: RobustBounds
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
    P = as_uncertain(P)
    if not P.blocks:
        raise ValueError("P has no uncertain blocks: hinfstruct is for a known plant")
    structure = full_structure(order, n_meas, n_con, dt=P.M.dt) if structure is None else structure
    corners: list[Delta] = [{}]
    models, history = [P.nominal_system()], []
    check_sizes(tuple(models), structure, n_meas, n_con, starts)
    best: tuple[StructResult, RobustBounds, int] | None = None
    result: StructResult | None = None
    for k in range(_MOST_ROUNDS):
        text = "" if best is None else f", certified {best[1].upper:.4g}"
        progress(k / _MOST_ROUNDS, f"{len(models)} members{text}")
        problem = Problem(models=tuple(models), structure=structure, target=NORM, hard_goals=tuple(hard_goals))
        result = search_problem(problem, starts=starts, seed=seed, near=None if result is None else result.theta)
        bracket = wcgain(lft(P, result.lti), accuracy=_ACCURACY, boxes=boxes)
        history.append(bracket.upper)
        if best is None or hard_goals or bracket.upper < best[1].upper:
            best = result, bracket, k
        if bracket.lower <= (1.0 + _GAIN) * result.norm or _is_settled(history):
            break
        corners.append(bracket.delta)
        models.append(P.close(interpolate_blocks(P.blocks, bracket.delta, bracket.omega, P.M.dt)))
    progress(1.0, "certified")
    assert best is not None
    return _make_robust(*best, tuple(corners), tuple(history))


def _is_settled(history: list[float]) -> bool:
    """Return whether the last designs no longer lowered the certified gain."""
    if len(history) <= _PATIENCE or not np.isfinite(min(history)):
        return False
    return min(history) > (1.0 - _GAIN) * min(history[:-_PATIENCE])


def _make_robust(
    result: StructResult, bracket: RobustBounds, k: int, corners: tuple[Delta, ...], history: tuple[float, ...]
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
