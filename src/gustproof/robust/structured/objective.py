"""Functions to minimise: goals of the worst model as functions of a structured controller's parameters."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gustproof.robust.lti.bilinear import bilinear_transform
from gustproof.robust.lti.norms import Peak, hinf_norm
from gustproof.robust.lti.state_space import Lti, Matrix, PartedPlant
from gustproof.robust.structured.blocks import Structure
from gustproof.robust.structured.goals import (
    ChannelGoal,
    ControllerSizeGoal,
    DecayGoal,
    GainGoal,
    Goal,
    NormKind,
    PoleRadiusGoal,
    StabilityGoal,
    extract_channel,
    require_positive,
)
from gustproof.robust.structured.loop import (
    BranchSlope,
    ClosedLoop,
    PoleMeasure,
    augment_plant,
    close_loop,
    h2_slope,
    loop_h2_norm,
    loop_peak,
    peak_slopes,
    pole_slopes,
)
from gustproof.robust.structured.search import Branch

LIMIT_MARGIN = 1e-4
"""[-] share of each limit reserved, because a search satisfies it to some digits only."""
_WARM_STARTS = 3
"""Number of recent peak frequencies to try first."""


class NormCriterion:
    """A norm of the closed loop divided by its limit."""

    def __init__(self, goal: Goal, plant: PartedPlant, limit: float, measure: NormKind) -> None:
        self.goal, self.plant, self.limit, self.measure = goal, plant, limit, measure
        self._warm: list[float] = []
        self._loop: ClosedLoop | None = None
        self._peak = Peak(gain=np.inf, omega=0.0)
        self.last = np.inf

    def value(self, M: Matrix) -> float:
        """Return the norm divided by its limit at the controller `M`; infinite if the loop is unstable."""
        self._loop = close_loop(self.plant, M)
        if self.measure is NormKind.RMS:
            self.last = loop_h2_norm(self._loop) / self.limit
            return self.last
        self._peak = loop_peak(self._loop, self._warm)
        if math.isfinite(self._peak.gain) and math.isfinite(self._peak.omega):
            self._warm = [self._peak.omega, *self._warm][:_WARM_STARTS]
        self.last = self._peak.gain / self.limit
        return self.last

    def check(self) -> float:
        """Return the last value, not less than by `hinf_norm`: rounding hides peaks of a stiff loop from the search."""
        if self._loop is not None and self.measure is not NormKind.RMS and math.isfinite(self.last):
            A, B, C, D = self._loop[:4]
            self.last = max(self.last, hinf_norm(Lti(A=A, B=B, C=C, D=D)).gain / self.limit)
        return self.last

    def slopes(self, near: float) -> list[BranchSlope]:
        """Return the branches of the last value within the fraction `near` of it."""
        assert self._loop is not None
        found = [h2_slope(self._loop)] if self.measure is NormKind.RMS else peak_slopes(self._loop, self._peak, near)
        return [BranchSlope(slope.value / self.limit, slope.gradient / self.limit) for slope in found]


class PoleCriterion:
    """The largest measure of a pole of a matrix `A + B2 M C2`, scaled: at most 1 if the goal is satisfied."""

    def __init__(self, goal: Goal, plant: PartedPlant, measure: PoleMeasure, *, offset: float, scale: float) -> None:
        self.goal, self._plant, self._measure, self._offset, self._scale = goal, plant, measure, offset, scale
        self._loop: ClosedLoop | None = None
        self.last = np.inf

    def value(self, M: Matrix) -> float:
        """Return `offset + measure / scale` at the controller `M`; infinite if the loop is not well posed."""
        self._loop = close_loop(self._plant, M)
        self.last = self._offset + self._measure.largest(self._loop.A) / self._scale
        return self.last

    def slopes(self, near: float) -> list[BranchSlope]:
        """Return the branches of the last value within `near` of it."""
        assert self._loop is not None
        if not np.isfinite(self.last):
            return []
        found = pole_slopes(self._loop.A, self._loop.B2, self._loop.C2, self._measure, near * self._scale)
        return [BranchSlope(self._offset + slope.value / self._scale, slope.gradient / self._scale) for slope in found]


class SizeCriterion:
    """The size of the controller's matrix M over its limit: its largest singular value, or its largest entry."""

    def __init__(self, goal: ControllerSizeGoal) -> None:
        self.goal, self._limit = goal, require_positive(goal.name, goal.limit)
        self._M: Matrix = np.zeros((0, 0))
        self.last = np.inf

    def value(self, M: Matrix) -> float:
        """Return the size over its limit at the controller `M`."""
        self._M = M
        self.last = float(np.max(np.abs(M)) if self.goal.entries else np.linalg.norm(M, 2)) / self._limit
        return self.last

    def slopes(self, near: float) -> list[BranchSlope]:
        """Return the branches of the last value within the fraction `near` of it."""
        if self.goal.entries:
            sizes, kept = np.abs(self._M).ravel(), np.sign(self._M).ravel()
            gradients = [kept[k] * np.eye(kept.size)[k].reshape(self._M.shape) for k in range(kept.size)]
        else:
            U, sizes, Vh = np.linalg.svd(self._M)
            gradients = [np.outer(U[:, k], Vh[k]) for k in range(sizes.size)]
        least = (1.0 - near) * np.max(sizes)
        slopes = [
            BranchSlope(float(size) / self._limit, gradient / self._limit)
            for size, gradient in zip(sizes, gradients, strict=True)
            if size >= least
        ]
        return sorted(slopes, key=lambda slope: -slope.value)


class PenaltyFunction:
    """The target over its scale, plus a penalty times the largest excess of a hard goal; each of the worst model.

    The penalty is exact: if its factor is large enough, the minimum is at the least target that satisfies the hard
    goals. With an infinite scale only the hard goals count; this finds parameters that satisfy them.
    """

    def __init__(
        self, basis: tuple[Matrix, Matrix], target: "list[NormCriterion]", hard_goals: "list[Criterion]"
    ) -> None:
        self.target, self.hard_goals, self.scale, self.penalty, self.evaluations = target, hard_goals, 1.0, 1.0, 0
        self._offset, self._basis = basis
        self._flat = self._basis.reshape(self._basis.shape[0], -1)
        self._theta: Matrix | None = None
        self._minimax = False
        self._targets: list[float] = []
        self._excesses: list[float] = []

    def use_penalty(self, scale: float, penalty: float = 1.0) -> "PenaltyFunction":
        """Return this function with another scale of the target and another penalty factor."""
        self.scale, self.penalty, self._minimax = scale, penalty, False
        return self

    def use_minimax(self, scale: float) -> "PenaltyFunction":
        """Return this function as the largest, not the sum, of target over scale and hard goals over their limits."""
        self.scale, self.penalty, self._minimax = scale, 1.0, True
        return self

    def value(self, theta: Matrix) -> float:
        """Return the value."""
        if self._theta is None or not np.array_equal(theta, self._theta):
            self._evaluate(theta)
        target = max(self._targets) / self.scale if math.isfinite(self.scale) else 0.0
        if self._minimax:
            return max([target, *(1.0 + excess for excess in self._excesses)])
        return target + self.penalty * max([0.0, *self._excesses])

    def branches(self, theta: Matrix, near: float) -> list[Branch]:
        """Return the branches within the fraction `near` of the largest, the largest first."""
        top = self.value(theta)
        if not math.isfinite(top):
            return []
        zero = Branch(0.0, np.zeros(theta.size))
        target = [zero]
        if math.isfinite(self.scale):
            target = self._branches(self.target, self._targets, 1.0 / self.scale, near * top)
        if self._minimax:
            hard = self._branches(self.hard_goals, [1.0 + excess for excess in self._excesses], 1.0, near * top)
            return _keep_nearest([*target, *hard], top, near)
        excesses = [zero, *self._branches(self.hard_goals, self._excesses, self.penalty, near * top)]
        sums = [Branch(a.value + b.value, a.gradient + b.gradient) for a in target for b in excesses]
        return _keep_nearest(sums, top, near)

    def _branches(
        self, criteria: "Sequence[Criterion]", values: list[float], factor: float, within: float
    ) -> list[Branch]:
        top, found = max(values, default=0.0), []
        for criterion, value in zip(criteria, values, strict=True):
            if factor * (top - value) <= within:
                share = within / (factor * abs(criterion.last)) if within else 0.0
                found += [
                    Branch(factor * (slope.value - criterion.last + value), factor * self._pull_back(slope.gradient))
                    for slope in criterion.slopes(min(share, 0.5))
                ]
        return found

    def _pull_back(self, gradient: Matrix) -> Matrix:
        return np.asarray(np.dot(self._flat, gradient.reshape(-1, 1))[:, 0])

    def _evaluate(self, theta: Matrix) -> None:
        self.evaluations += 1
        M = self._offset + np.dot(theta[None], self._flat).reshape(self._offset.shape)
        self._theta = theta.copy()
        self._targets = [criterion.value(M) for criterion in self.target]
        self._excesses = [criterion.value(M) - 1.0 + LIMIT_MARGIN for criterion in self.hard_goals]

    def goal_values(self, theta: Matrix, *, checked: bool = False) -> tuple[float, dict[str, float]]:
        """Return the target, and each hard goal over its limit by its name, each of the worst model.

        If `checked`, norms are computed again by another method than the search's.
        """
        self._evaluate(theta)
        if checked:
            self._targets = [criterion.check() for criterion in self.target]
            for criterion in self.hard_goals:
                if isinstance(criterion, NormCriterion):
                    criterion.check()
        hard: dict[str, float] = {}
        for criterion in self.hard_goals:
            hard[criterion.goal.name] = max(hard.get(criterion.goal.name, -np.inf), criterion.last)
        return max(self._targets), hard


def _keep_nearest(branches: list[Branch], top: float, near: float) -> list[Branch]:
    branches.sort(key=lambda branch: -branch.value)
    return branches[:1] if near == 0.0 else [branch for branch in branches if branch.value >= (1.0 - near) * top]


Criterion = NormCriterion | PoleCriterion | SizeCriterion
"""One goal on one model."""


class Stability:
    """The largest growth [1/s] of a pole of the closed loops of all models; of continuous ones their abscissa."""

    def __init__(self, basis: tuple[Matrix, Matrix], plants: list[PartedPlant], dt: float) -> None:
        self._plants = plants
        self._measure = PoleMeasure(dt=dt, transformed=dt > 0.0)
        self._offset, self._basis = basis

    def value(self, theta: Matrix) -> float:
        """Return the value."""
        M = self._offset + np.tensordot(theta, self._basis, axes=1)
        return max(self._measure.largest(close_loop(plant, M).A) for plant in self._plants)

    def branches(self, theta: Matrix, near: float) -> list[Branch]:
        """Return the branch of the fastest growing pole; `near` is not used."""
        M = self._offset + np.tensordot(theta, self._basis, axes=1)
        loops = [close_loop(plant, M) for plant in self._plants]
        worst = max(loops, key=lambda loop: self._measure.largest(loop.A))
        if not np.all(np.isfinite(worst.A)):
            return []
        slopes = pole_slopes(worst.A, worst.B2, worst.C2, self._measure, 0.0)[:1]
        return [Branch(slope.value, np.tensordot(self._basis, slope.gradient, axes=2)) for slope in slopes]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """Least gain of `target` over the controllers of a structure that satisfy the hard goals."""

    models: tuple[Lti, ...]
    """Generalised plants, all continuous or all sampled like the structure; the worst counts."""
    structure: Structure
    """Structure of the controller."""
    target: GainGoal
    """Goal to minimise."""
    hard_goals: tuple[Goal, ...]
    """Goals to satisfy."""
    unit: Matrix | None = None
    """(size,) unit of each parameter: theta of a search times it is that of the structure; `None` for 1."""

    def balanced_unit(self) -> Matrix:
        """Return (size,) the parameters that act on the first model with the strength of one unit.

        The unit of an entry of [A, B; C, D] is that of its control, `1 / |B_u|`, times that of its measurement,
        `1 / |C_y|`. The units of the controller's own states are 1.
        """
        model, shape = self._continuous_models()[0], self.structure
        controls = np.linalg.norm(model.B[:, model.n_inputs - shape.n_con :], axis=0)
        measurements = np.linalg.norm(model.C[model.n_outputs - shape.n_meas :], axis=1)
        rows, columns = np.ones(shape.order + shape.n_con), np.ones(shape.order + shape.n_meas)
        rows[shape.order :] = 1.0 / np.where(controls > 0.0, controls, 1.0)
        columns[shape.order :] = 1.0 / np.where(measurements > 0.0, measurements, 1.0)
        share = np.abs(shape.basis()[1])
        units = np.tensordot(share, np.log(np.outer(rows, columns)), axes=2) / np.sum(share, axis=(1, 2))
        return np.asarray(np.exp(units))

    def _basis(self) -> tuple[Matrix, Matrix]:
        offset, basis = self.structure.basis()
        return offset, basis if self.unit is None else self.unit[:, None, None] * basis

    def objective(self) -> PenaltyFunction:
        """Return the function to minimise."""
        target = [self._norm_criterion(self.target, model) for model in self._continuous_models()]
        hard = [criterion for goal in self.hard_goals for criterion in self._criteria(goal)]
        return PenaltyFunction(self._basis(), target, hard)

    def stability(self) -> Stability:
        """Return the function that is negative if all closed loops are stable."""
        plants = [self._augment(model) for model in self._continuous_models()]
        return Stability(self._basis(), plants, self.structure.dt)

    def _continuous_models(self) -> list[Lti]:
        return [bilinear_transform(model) if model.dt else model for model in self.models]

    def _augment(self, model: Lti) -> PartedPlant:
        shape = self.structure
        return augment_plant(model, shape.n_meas, shape.n_con, shape.order, shape.dt)

    def _criteria(self, goal: Goal) -> "list[Criterion]":
        """Return the goal's criteria, one for each model or one of the controller alone."""
        dt = self.structure.dt
        if isinstance(goal, ControllerSizeGoal):
            return [SizeCriterion(goal)]
        if isinstance(goal, StabilityGoal):
            if not self.structure.order:
                return []
            alone = _controller_alone(self.structure)
            return [PoleCriterion(goal, alone, PoleMeasure(dt=dt), offset=1.0 + goal.margin, scale=1.0)]
        if isinstance(goal, DecayGoal | PoleRadiusGoal):
            sized = isinstance(goal, PoleRadiusGoal)
            scale = require_positive(goal.name, goal.limit if isinstance(goal, PoleRadiusGoal) else goal.minimum)
            measure = PoleMeasure(dt=dt, transformed=dt > 0.0, size=sized)
            offset = 0.0 if sized else 2.0  # a growth of -minimum has the value 1
            return [
                PoleCriterion(goal, self._augment(model), measure, offset=offset, scale=scale)
                for model in self._continuous_models()
            ]
        return [self._norm_criterion(goal, model) for model in self._continuous_models()]

    def _norm_criterion(self, goal: ChannelGoal, model: Lti) -> NormCriterion:
        P, limit = extract_channel(goal, model, self.structure.n_meas, self.structure.n_con, self.structure.dt)
        measure = goal.measure if isinstance(goal, GainGoal) else NormKind.PEAK
        return NormCriterion(goal, self._augment(P), limit, measure)


def _controller_alone(structure: Structure) -> PartedPlant:
    """Return the loop whose poles are the controller's own: its integrators, or delays, and no plant."""
    nothing = Lti(
        A=np.zeros((0, 0)),
        B=np.zeros((0, structure.n_con)),
        C=np.zeros((structure.n_meas, 0)),
        D=np.zeros((structure.n_meas, structure.n_con)),
    )
    return augment_plant(nothing, structure.n_meas, structure.n_con, structure.order)
