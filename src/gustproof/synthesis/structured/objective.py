"""What a search minimises: goals of the worst model as functions of a structured controller's parameters."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gustproof.lti.state_space import Lti, Matrix
from gustproof.synthesis.structured.blocks import Structure
from gustproof.synthesis.structured.goals import GainGoal, Goal, NormKind, StabilityGoal, extract_channel
from gustproof.synthesis.structured.loop import (
    AugmentedPlant,
    ClosedLoop,
    LoopPeak,
    Slope,
    abscissa,
    abscissa_slopes,
    augment_plant,
    close_loop,
    h2_slope,
    loop_h2_norm,
    loop_peak,
    peak_slopes,
)
from gustproof.synthesis.structured.search import Branch

LIMIT_MARGIN = 1e-4
"""[-] share of each limit that is kept back, because a search meets it to some digits only."""
_WARM_STARTS = 3
"""Frequencies of the last peaks that are tried first."""


class NormCriterion:
    """A norm of the closed loop over its limit."""

    def __init__(self, goal: Goal, plant: AugmentedPlant, limit: float, measure: NormKind) -> None:
        self.goal, self.plant, self.limit, self.measure = goal, plant, limit, measure
        self._warm: list[float] = []
        self._loop: ClosedLoop | None = None
        self._peak = LoopPeak(np.inf, 0.0)
        self.last = np.inf

    def value(self, M: Matrix) -> float:
        """Return the norm over its limit at the controller `M`, infinite if the loop is unstable."""
        self._loop = close_loop(self.plant, M)
        if self.measure is NormKind.RMS:
            self.last = loop_h2_norm(self._loop) / self.limit
            return self.last
        self._peak = loop_peak(self._loop, self._warm)
        if np.isfinite(self._peak.gain) and np.isfinite(self._peak.omega):
            self._warm = [self._peak.omega, *self._warm][:_WARM_STARTS]
        self.last = self._peak.gain / self.limit
        return self.last

    def slopes(self, near: float) -> list[Slope]:
        """Return the branches of the last value within the fraction `near` of it."""
        assert self._loop is not None
        found = [h2_slope(self._loop)] if self.measure is NormKind.RMS else peak_slopes(self._loop, self._peak, near)
        return [Slope(slope.value / self.limit, slope.gradient / self.limit) for slope in found]


class PoleCriterion:
    """One plus the spectral abscissa of the controller and a margin [1/s]: at most 1 if the margin is kept."""

    def __init__(self, goal: StabilityGoal, order: int) -> None:
        self.goal, self._order = goal, order
        self._M: Matrix = np.zeros((0, 0))
        self.last = np.inf

    def value(self, M: Matrix) -> float:
        """Return `1 + abscissa + margin` at the controller `M`."""
        self._M = M
        n = self._order
        self.last = 1.0 + abscissa(M[:n, :n]) + self.goal.margin if n else 0.0
        return self.last

    def slopes(self, near: float) -> list[Slope]:
        """Return the branches of the last value."""
        n = self._order
        rows, columns = np.eye(n, self._M.shape[0]), np.eye(self._M.shape[1], n)
        found = abscissa_slopes(self._M[:n, :n], rows, columns, near) if n else []
        return [Slope(1.0 + slope.value + self.goal.margin, slope.gradient) for slope in found]


class PenaltyFunction:
    """The target over its scale, and beyond their limits the worst of the other goals times a price; worst model each.

    The penalty is exact: where the price is high enough, the least value is at the least target within the limits.
    With an infinite scale only the other goals count: what finds parameters that keep them.
    """

    def __init__(self, structure: Structure, target: "list[NormCriterion]", limits: "list[Criterion]") -> None:
        self.target, self.limits, self.scale, self.price, self.evaluations = target, limits, 1.0, 1.0, 0
        self._offset, self._basis = structure.basis()
        self._theta: Matrix | None = None
        self._together = False
        self._targets: list[float] = []
        self._passed: list[float] = []

    def use_penalty(self, scale: float, price: float = 1.0) -> "PenaltyFunction":
        """Return this function with another scale of the target and price of a limit."""
        self.scale, self.price, self._together = scale, price, False
        return self

    def centred(self, scale: float) -> "PenaltyFunction":
        """Return the largest of the target over its scale and the other goals over their limits instead of a sum."""
        self.scale, self.price, self._together = scale, 1.0, True
        return self

    def value(self, theta: Matrix) -> float:
        """Return the function."""
        if self._theta is None or not np.array_equal(theta, self._theta):
            self._evaluate(theta)
        wanted = max(self._targets) / self.scale if np.isfinite(self.scale) else 0.0
        if self._together:
            return max([wanted, *(1.0 + passed for passed in self._passed)])
        return wanted + self.price * max([0.0, *self._passed])

    def branches(self, theta: Matrix, near: float) -> list[Branch]:
        """Return the branches within the fraction `near` of the largest, which stands first."""
        top = self.value(theta)
        if not np.isfinite(top):
            return []
        nothing = Branch(0.0, np.zeros(theta.size))
        wanted = [nothing]
        if np.isfinite(self.scale):
            wanted = self._branches(self.target, self._targets, 1.0 / self.scale, near * top)
        if self._together:
            limits = self._branches(self.limits, [1.0 + passed for passed in self._passed], 1.0, near * top)
            return _keep_nearest([*wanted, *limits], top, near)
        passed = [nothing, *self._branches(self.limits, self._passed, self.price, near * top)]
        sums = [Branch(a.value + b.value, a.gradient + b.gradient) for a in wanted for b in passed]
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
        return np.asarray(np.tensordot(self._basis, gradient, axes=2))

    def _evaluate(self, theta: Matrix) -> None:
        self.evaluations += 1
        M = self._offset + np.tensordot(theta, self._basis, axes=1)
        self._theta = theta.copy()
        self._targets = [criterion.value(M) for criterion in self.target]
        self._passed = [criterion.value(M) - 1.0 + LIMIT_MARGIN for criterion in self.limits]

    def reached(self, theta: Matrix) -> tuple[float, dict[str, float]]:
        """Return the target, worst over the models, and each other goal over its limit, by its name."""
        self._evaluate(theta)
        kept: dict[str, float] = {}
        for criterion in self.limits:
            kept[criterion.goal.name] = max(kept.get(criterion.goal.name, -np.inf), criterion.last)
        return max(self._targets), kept


def _keep_nearest(branches: list[Branch], top: float, near: float) -> list[Branch]:
    branches.sort(key=lambda branch: -branch.value)
    return branches[:1] if near == 0.0 else [branch for branch in branches if branch.value >= (1.0 - near) * top]


Criterion = NormCriterion | PoleCriterion
"""One goal on one model."""


class Stability:
    """The spectral abscissa [rad/s] of the closed loops of all models, the largest."""

    def __init__(self, structure: Structure, plants: list[AugmentedPlant]) -> None:
        self._plants = plants
        self._offset, self._basis = structure.basis()

    def value(self, theta: Matrix) -> float:
        """Return the function."""
        M = self._offset + np.tensordot(theta, self._basis, axes=1)
        return max(abscissa(close_loop(plant, M).A) for plant in self._plants)

    def branches(self, theta: Matrix, near: float) -> list[Branch]:
        """Return the branch of the rightmost eigenvalue; `near` is not used."""
        M = self._offset + np.tensordot(theta, self._basis, axes=1)
        loops = [close_loop(plant, M) for plant in self._plants]
        worst = max(loops, key=lambda loop: abscissa(loop.A))
        slopes = abscissa_slopes(worst.A, worst.B2, worst.C2, 0.0)[:1]
        return [Branch(slope.value, np.tensordot(self._basis, slope.gradient, axes=2)) for slope in slopes]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """A structured design problem: models, structure, what to minimise and what to keep."""

    models: tuple[Lti, ...]
    """Generalised plants; the worst counts."""
    structure: Structure
    """What the controller may be."""
    target: GainGoal
    """What is minimised."""
    limits: tuple[Goal, ...]
    """What must be kept."""

    def objective(self) -> PenaltyFunction:
        """Return the function to minimise."""
        target = [_norm_criterion(self.target, model, self.structure) for model in self.models]
        limits: list[Criterion] = []
        for goal in self.limits:
            if isinstance(goal, StabilityGoal):
                limits.append(PoleCriterion(goal, self.structure.order))
            else:
                limits += [_norm_criterion(goal, model, self.structure) for model in self.models]
        return PenaltyFunction(self.structure, target, limits)

    def stability(self) -> Stability:
        """Return the function that says whether all models are stable."""
        return Stability(self.structure, [self._augmented(model) for model in self.models])

    def _augmented(self, model: Lti) -> AugmentedPlant:
        return augment_plant(model, self.structure.n_meas, self.structure.n_con, self.structure.order)


def _norm_criterion(goal: Goal, model: Lti, structure: Structure) -> NormCriterion:
    assert not isinstance(goal, StabilityGoal)
    P, limit = extract_channel(goal, model, structure.n_meas, structure.n_con)
    measure = goal.measure if isinstance(goal, GainGoal) else NormKind.PEAK
    return NormCriterion(goal, augment_plant(P, structure.n_meas, structure.n_con, structure.order), limit, measure)
