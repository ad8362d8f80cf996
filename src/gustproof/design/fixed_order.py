"""Solve a design for a controller with fewer states than the plant, one part for each axis."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gustproof.airframe.rotational import Envelope
from gustproof.design.designs import Design
from gustproof.design.methods import uncertain_plant
from gustproof.errors import DesignError
from gustproof.robust.lti.state_space import Lti
from gustproof.robust.structured.blocks import decoupled_structure, observer_structure
from gustproof.robust.structured.goals import Goal
from gustproof.robust.structured.hinfstruct import Progress, StructResult, hinfstruct
from gustproof.robust.structured.robust import robust_hinfstruct
from gustproof.robust.uncertain.interconnection import Interconnection

_AXES = 3


def solve_structured(
    design: Design,
    problem: Interconnection,
    *,
    order: int,
    starts: int,
    seed: int,
    progress: Progress,
    envelope: Envelope | None = None,
    hard_goals: Sequence[Goal] = (),
) -> StructResult:
    """Return a controller of `order` states in total, the same number for each axis, without coupling between axes.

    The controller satisfies the `hard_goals`. With two or more states an axis, a regulator's states begin with Euler
    angles and body rates, as in a central controller. Its law can then be self-scheduled. With an `envelope` of
    attitudes and rates, constant in time, the worst of them are designed for in turn, and the gain over all of them is
    certified.

    Raises
    ------
    DesignError
        If `order` does not divide among the axes, a self-scheduled law is required and impossible, or no start
        succeeds.
    """
    if order < _AXES or order % _AXES:
        raise DesignError(f"order {order} can't be shared out among {_AXES} axes: it must be 3, 6, 9, ...")
    if problem.n_meas % _AXES:
        raise DesignError(f"design {design.name} has an accelerometer: its law is the central controller alone")
    each = order // _AXES
    estimates = each >= 2 and problem.n_meas == _AXES
    if design.scheduled and not estimates:
        raise DesignError(f"design {design.name} is self-scheduled: it needs an order of 6 or more, and gyros alone")
    if estimates:
        structure = observer_structure(each, _AXES, leak=design.leak)
    else:
        structure = decoupled_structure(each, problem.n_meas, problem.n_con)
    sizes = problem.n_meas, problem.n_con
    own: dict[str, Any] = {"structure": structure, "hard_goals": hard_goals}
    if envelope is None:
        plant = problem.plant()
        result = hinfstruct(plant, *sizes, **own, starts=starts, seed=seed, progress=progress)
    else:
        family = uncertain_plant(design, problem, envelope)
        result = robust_hinfstruct(family, *sizes, **own, starts=starts, seed=seed, progress=progress)
    # from one block an axis to the order of a law: all attitudes, then all rates, then the rest
    first = np.arange(order).reshape(_AXES, each).T.ravel()
    return replace(result, lti=_reorder_states(result.lti, first))


def _reorder_states(K: Lti, order: np.ndarray[tuple[int], np.dtype[np.intp]]) -> Lti:
    return Lti(A=K.A[np.ix_(order, order)], B=K.B[order], C=K.C[:, order], D=K.D)
