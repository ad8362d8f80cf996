"""Fixed-order, fixed-structure H-infinity synthesis by non-smooth optimisation: `hinfstruct`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from gustproof.errors import DesignError
from gustproof.robust.hinf.checked_controller import CheckedController, keep_names
from gustproof.robust.hinf.conditions import require_sizes
from gustproof.robust.hinf.hinfsyn import hinfsyn
from gustproof.robust.lti.bilinear import bilinear_transform, tustin
from gustproof.robust.lti.norms import Peak, hinf_norm
from gustproof.robust.lti.state_space import LinearSystem, Lti, Matrix, as_lti, lft
from gustproof.robust.structured.blocks import Structure, full_structure
from gustproof.robust.structured.goals import NORM, GainGoal, Goal
from gustproof.robust.structured.objective import PenaltyFunction, Problem
from gustproof.robust.structured.search import STEPPED, Minimum, minimize

if TYPE_CHECKING:
    import control

_BACKOFFS = (1.1, 1.3, 3.0)
"""[-] levels over the least of the central controllers that are reduced to starting points."""
_STABLE_ABSCISSA = -1e-3
"""[rad/s] spectral abscissa below which a loop is stable enough to start from."""
_STABILIZING_STEPS, _STEPS, _RESTARTS = 300, 1000, 2
_SIZES = (1.0, 0.1, 10.0, 0.01, 100.0)
"""[-] sizes of random starts in turn: the best of several local minima may have small or large parameters."""
_ATTEMPTS = 12
"""Largest number of further attempts to stabilise for each start, if all failed."""
_FRESH, _DECADES, _CHANGES = 3, (-2.0, 2.0), (-2.0, 0.5)
"""Every third attempt is at a new point; decades of the sizes of these, and of the relative changes in the others."""
_UNSTABLE = "unstable"
"""Beginning of the failure of a start without a stable loop."""
_PERTURBATIONS = (1e-3, 1.0)
"""[-] least and largest relative size of the random change to the best parameters before its search is repeated."""
_LENGTHS, _ALLOWED = (4.0, 2.0, 1.0, 0.5), 1.5
"""[-] lengths of steps along the last progress, in multiples of it, and the largest relative target there."""
_LUCK = 3
"""Largest number of restarts as a multiple of those without progress."""
_SINGULAR = 1e10
"""[-] condition number of `A + I` beyond which a sampled plant has a pole at z = -1."""
_PENALTY, _PENALTY_GROWTH, _ROUNDS = 10.0, 10.0, 12
"""Initial penalty factor of a hard goal, its growth where it is too low, and the largest number of rounds."""
_AGREEMENT = 1e-5
"""[-] relative difference below which the results of two searches agree."""
_ROUND_GAIN = 1e-3
"""[-] relative progress of a round below which no other follows."""

_FAR, _WORTH = 1e7, 1e-3
"""[-] size in balanced units beyond which a static gain has diverged, and the relative progress that excuses it."""

_BALANCED, _NEAR = ", balanced", ", near it"
_ENDS = "", _BALANCED, ", plain steps"
"""Ends of the names of starts by metric; `_NEAR` is that of starts near the best."""

Progress = Callable[[float, str], None]
"""Callback for the fraction done [0..1] and a text on the current work."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SearchStart:
    """One start of the search, and its result."""

    name: str
    """Origin: `central 1.1` (a reduced central controller of hinfsyn) or `random 3`."""
    target: float
    """[-] final target; infinite if no stable loop was found or a hard goal could not be satisfied."""
    failure: str
    """Reason for an infinite `target`; empty if it is finite."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class StructResult(CheckedController):
    """A controller of the required structure and a record of its search; states are those of the blocks in order.

    The level `gamma` is the achieved `norm` itself, worst over the models.
    """

    target: float
    """[-] the minimised target: `gamma` unless another soft goal was given."""
    hard_goals: dict[str, float]
    """[-] each hard goal's value over its limit, worst over the models, by the goal's name; at most 1."""
    gamma_opt: float | None
    """[-] least norm of any controller of the first model, from `hinfsyn`; `None` if that is not solvable."""
    theta: Matrix
    """(size,) parameters of the structure."""
    winner: int
    """Index in `starts` of this result."""
    starts: tuple[SearchStart, ...]
    """All starts in the order of the search."""
    evaluations: int
    """Number of evaluations of the objective."""
    _parts: dict[str, Lti]
    """The tuned blocks."""

    @property
    def blocks(self) -> dict[str, "control.StateSpace"]:
        """Tuned blocks by name, copies at each call."""
        return {name: part.to_control() for name, part in self._parts.items()}


def hinfstruct(
    P: LinearSystem | Sequence[LinearSystem],
    n_meas: int,
    n_con: int,
    *,
    order: int = 0,
    structure: Structure | None = None,
    starts: int = 5,
    seed: int = 1,
    soft_goal: GainGoal | None = None,
    hard_goals: Sequence[Goal] = (),
    progress: Progress = lambda _fraction, _text: None,
) -> StructResult:
    """Return a controller of a given order and structure with a small H-infinity norm from w to z.

    The last `n_meas` outputs of `P` are measured, its last `n_con` inputs are controls; D is arbitrary. From several
    starts, BFGS first minimises the spectral abscissa until the loop is stable, then the norm over the parameters.
    If no start gets stable, up to twelve further attempts for each follow, from points of many sizes and near the best.
    Gradients are analytic, from the singular vectors at the peaks of the norm.

    The result is a local minimum of a problem that is not convex. The only bound on better controllers is `gamma_opt`,
    which no structure beats. The same seed gives the same controller. Cost: some thousand eigenvalue problems of the
    closed loop's order a start.

    Parameters
    ----------
    P
        Generalised plant, inputs (w, u), outputs (z, y); or several, of which the worst counts. All are continuous, or
        have one sample time: the controller is then sampled too, and its norm that of the sampled loop.
    n_meas, n_con
        Number of measurements y and controls u.
    order
        Number of controller states without further structure; 0 is static.
    structure
        Tunable blocks; if given, `order` is not used.
    starts
        Number of starts. If `hinfsyn` solves the first model, up to three are its central controllers, reduced. The
        others are random; they take turns in size, and in units of 1 or those of the plant's balance. Where none of
        several agree, a static gain is searched from each in the other units too, and with other first steps.
    seed
        Seed of the random starts.
    soft_goal
        Goal to minimise instead of the norm from w to z.
    hard_goals
        Goals to satisfy, from `gustproof.robust.structured.goals`: margins, roll-off, decay, pole radius, |K|.
    progress
        Callback for the fraction done and the best result so far.

    Raises
    ------
    ValueError
        If sizes or sample times do not fit, a sampled model has a pole at z = -1, or an argument is out of range.
    DesignError
        If no start led to a stable loop that satisfies the hard goals; the text names each start's failure. This does
        not prove that there is no such controller.

    References
    ----------
    P. Apkarian, D. Noll, Nonsmooth H-infinity synthesis, IEEE TAC 51 (2006), 71-86. J. V. Burke, D. Henrion,
    A. S. Lewis, M. L. Overton, HIFOO, ROCOND 2006.

    Examples
    --------
    >>> from control import ss
    >>> from gustproof import hinfstruct
    >>> plant = ss([[1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 0.1], [0, 0.1, 0]])
    >>> result = hinfstruct(plant, n_meas=1, n_con=1, order=0, starts=1)
    >>> f"{result.norm:.2f}, least of any order {result.gamma_opt:.2f}"
    '0.15, least of any order 0.15'
    """
    models = tuple(as_lti(model) for model in P) if isinstance(P, Sequence) else (as_lti(P),)
    structure = full_structure(order, n_meas, n_con, dt=models[0].dt) if structure is None else structure
    check_sizes(models, structure, n_meas, n_con, starts)
    target = NORM if soft_goal is None else soft_goal
    problem = Problem(models=models, structure=structure, target=target, hard_goals=tuple(hard_goals))
    found = search_problem(problem, starts=starts, seed=seed, progress=progress)
    return keep_names(found, P[0] if isinstance(P, Sequence) else P)


def search_problem(
    problem: Problem,
    *,
    starts: int,
    seed: int,
    near: Matrix | None = None,
    progress: Progress = lambda _fraction, _text: None,
) -> StructResult:
    """Return the best controller from `starts` starts, or from the parameters `near` (size,) alone.

    Raises
    ------
    DesignError
        If no start led to a stable loop that satisfies the hard goals.
    """
    gamma_opt, points = _starting_points(problem, starts, seed)
    if near is not None:
        points = [("design before", near)]
    search = _Search(problem, np.random.default_rng([seed, starts]))
    search.run(points, 0 if near is not None else _ATTEMPTS * starts, progress)
    progress(1.0, "checked")
    if search.best is None:
        failures = "; ".join(f"{start.name}: {start.failure}" for start in search.tried)
        more = f" and {search.attempts} more for a stable loop" if search.attempts else ""
        raise DesignError(f"no controller of this structure was found in {len(search.tried)} starts{more}: {failures}")
    return search.result(gamma_opt)


class _Metric(NamedTuple):
    """Units and first steps of a search: where one choice creeps or diverges, another may arrive."""

    problem: Problem
    objective: PenaltyFunction
    relative: bool
    """True if first steps are relative: entries of a static gain, in units of 1, may be of very different sizes."""


class _Search:
    """All starts of one problem in two or three metrics, and the parameters found."""

    def __init__(self, problem: Problem, rng: np.random.Generator) -> None:
        self._unit = problem.balanced_unit()
        balanced = replace(problem, unit=self._unit)
        first = _Metric(problem, problem.objective(), relative=not problem.structure.order)
        self._metrics = [first, _Metric(balanced, balanced.objective(), relative=False)]
        if first.relative and problem.target is NORM and not problem.hard_goals:
            self._metrics.append(first._replace(relative=False))
        self._rng = rng
        self._found: list[Matrix] = []
        self.tried: list[SearchStart] = []
        self.attempts = 0

    @property
    def best(self) -> int | None:
        """Index of the least target so far; `None` if all failed.

        A diverged gain is no minimum, and its norm is unreliable: it counts only if every search diverged.
        """
        finite = [k for k, start in enumerate(self.tried) if np.isfinite(start.target)]
        kept = [k for k in finite if not self._is_diverged(k)]
        return min(kept or finite, key=lambda k: self.tried[k].target, default=None)

    @property
    def least(self) -> float:
        """The least target so far; infinite if all failed."""
        return np.inf if self.best is None else self.tried[self.best].target

    def run(self, points: list[tuple[str, Matrix]], attempts: int, progress: Progress) -> None:
        """Search from each of `points`, then near the best until two agree or that helps no longer.

        If no two agree, a static gain is first searched from all points, if several, in the other metrics. If none got
        stable, up to `attempts` random points are tried until one does.
        """
        rounds = [[int(name.endswith(_BALANCED)) for name, _ in points]]
        if len(self._metrics) > 2 and len(points) > 1:
            rounds += [[2] * len(points), [1 - metric for metric in rounds[0]]]
        limit, total = _RESTARTS * len(points), len(rounds) * len(points)
        for done, metrics in enumerate(rounds):
            if self._is_confirmed():
                break
            for k, ((name, theta), metric) in enumerate(zip(points, metrics, strict=True), done * len(points)):
                label = f"{name.removesuffix(_BALANCED)}{_ENDS[metric]}"
                self._start(label, theta, metric, partial(progress, k / (total + limit)))
        if all(start.failure.startswith(_UNSTABLE) for start in self.tried):
            self._stabilize(attempts, lambda text: progress(total / (total + limit), text))
        self._search_near_best(limit, lambda done, text: progress((total + done) / (total + limit), text))

    def _stabilize(self, attempts: int, progress: Callable[[str], None]) -> None:
        """Search for a stable loop from random points and near the best of them, and start from the first found."""
        problem, _, relative = self._metrics[0]
        rng, stability, best = self._rng, problem.stability(), Minimum(theta=self._found[0], value=np.inf)
        for self.attempts in range(1, attempts + 1):
            progress(f"attempt {self.attempts} at a stable loop; least abscissa {best.value:.3g}")
            if self.attempts % _FRESH == 1:
                theta = 10.0 ** rng.uniform(*_DECADES) * problem.structure.draw(rng)
            else:
                theta = best.theta * (1.0 + 10.0 ** rng.uniform(*_CHANGES) * rng.normal(size=best.theta.size))
            turn = relative and self.attempts % 2 == 0
            found = minimize(stability, theta, steps=_STEPS, stop_below=_STABLE_ABSCISSA, relative=turn)
            best = min(best, found, key=lambda minimum: minimum.value)
            if best.value < 0.0:
                self._start(f"attempt {self.attempts}", best.theta, 0, progress)
                break

    def _search_near_best(self, limit: int, progress: Callable[[int, str], None]) -> None:
        """Search near the best until two agree, or `limit` searches made little progress."""
        failed, last = 0, None
        for k in range(_LUCK * limit):
            best = self.best
            if failed == limit or best is None or self._is_diverged(best) or self._is_confirmed():
                break
            winner, before = self.tried[best], self.least
            point, told = self._point_near(best, last), partial(progress, failed)
            self._start(f"{winner.name.removesuffix(_NEAR)}{_NEAR}", point, k % 2, told)
            failed += self.least > (1.0 - _ROUND_GAIN) * before
            last = best if self.least < before else None

    def _point_near(self, best: int, last: int | None) -> Matrix:
        """Return parameters near the best; of a gain, further along the step from the best before, the index `last`.

        A search that stopped on a crease often stopped in a valley along it.
        """
        objective, theta = self._metrics[0].objective, self._found[best]
        if last is not None and len(self._metrics) > 2:
            for length in _LENGTHS:
                further = theta + length * (theta - self._found[last])
                if objective.value(further) < _ALLOWED * self.least:
                    return further
        return _perturb(objective, theta, self._rng)

    def _start(self, name: str, theta: Matrix, metric: int, progress: Callable[[str], None]) -> None:
        """Search from a point; `progress` hears where each step is, be it in search of a stable loop or of a level."""
        unit, steps = self._unit if metric == 1 else 1.0, count(1)
        best = f"; best so far {self.least:.5g}" if self.tried else ""
        progress(f"{name}{best}")
        heard = STEPPED.set(lambda value: progress(f"{name}, step {next(steps)} at {value:.4g}{best}"))
        try:
            start, scaled = _descend(self._metrics[metric], name, theta / unit)
        finally:
            STEPPED.reset(heard)
        self.tried.append(start)
        self._found.append(scaled * unit)

    def _is_diverged(self, k: int) -> bool:
        return len(self._metrics) > 2 and bool(np.max(np.abs(self._found[k]) / self._unit) > _FAR)

    def _is_confirmed(self) -> bool:
        """Return whether two searches agree on the least target, so that no better one is nearby.

        Diverged gains agree along a valley without end: other metrics may leave it, or find its lower targets.
        """
        best = self.best
        if best is None:
            return False
        level = (1.0 + _AGREEMENT) * self.tried[best].target
        near = [k for k, start in enumerate(self.tried) if start.target <= level]
        far = [k for k in near if self._is_diverged(k)]
        least = min((self.tried[k].target for k in far), default=np.inf)
        return len(near) - len(far) > 1 and least >= (1.0 - _WORTH) * self.tried[best].target

    def result(self, gamma_opt: float | None) -> StructResult:
        """Return the best, checked."""
        best = self.best
        assert best is not None
        problem, objective, _ = self._metrics[0]
        limit = np.inf if self._is_diverged(best) else (1.0 - _WORTH) * self.least
        far = [k for k, start in enumerate(self.tried) if start.target < limit and self._is_diverged(k)]
        checked = [self._checked_norm(k) for k in far]
        if min(checked, default=np.inf) < limit:
            best = far[int(np.argmin(checked))]
        evaluations = sum(metric.objective.evaluations for metric in self._metrics[:2])
        found = _make_result(problem, objective, self._found[best], tuple(self.tried), gamma_opt)
        return replace(found, winner=best, evaluations=evaluations)

    def _checked_norm(self, k: int) -> float:
        """Return the norm of a diverged gain, which rounding may have flattered; infinite if the loop is unstable."""
        problem, _, _ = self._metrics[0]
        try:
            return max(self.tried[k].target, _worst_peak(problem, problem.structure.controller(self._found[k])).gain)
        except DesignError:
            return np.inf


def check_sizes(models: tuple[Lti, ...], structure: Structure, n_meas: int, n_con: int, starts: int) -> None:
    """Check that plants, structure and arguments fit; raises ValueError if not."""
    if starts < 1:
        raise ValueError(f"starts is {starts}, must be at least 1")
    if (structure.n_meas, structure.n_con) != (n_meas, n_con):
        raise ValueError(f"the structure is {structure.n_con} x {structure.n_meas}, K must be {n_con} x {n_meas}")
    for model in models:
        if model.dt != structure.dt:
            raise ValueError(f"P has the sample time {model.dt} s, the structure {structure.dt} s (0: continuous)")
        if model.dt and np.linalg.cond(model.A + np.eye(model.order)) > _SINGULAR:
            raise ValueError("P has a pole at z = -1, where the bilinear transformation is singular")
        require_sizes(model, n_meas, n_con)


def _starting_points(problem: Problem, starts: int, seed: int) -> tuple[float | None, list[tuple[str, Matrix]]]:
    """Return hinfsyn's least level of the first model, if any, and named parameters to start from."""
    model, structure = problem.models[0], problem.structure
    n_meas, n_con = structure.n_meas, structure.n_con
    found: list[tuple[str, Matrix]] = []
    gamma_opt = None
    try:
        for backoff in _BACKOFFS:
            central = hinfsyn(bilinear_transform(model) if model.dt else model, n_meas, n_con, backoff=backoff)
            gamma_opt = central.gamma_opt
            K = tustin(central.lti, model.dt) if model.dt else central.lti
            theta = structure.fit(K) if structure.order else None
            if theta is not None:
                found.append((f"central {backoff:g}", theta))
    except (DesignError, ValueError):  # not solvable, or a plant without states: random starts only
        pass
    found = found[:starts]
    unit = problem.balanced_unit()
    for k in range(starts - len(found)):
        theta = _SIZES[k // 2 % len(_SIZES)] * structure.draw(np.random.default_rng([seed, k]))
        found.append((f"random {k + 1}{_BALANCED}", unit * theta) if k % 2 else (f"random {k + 1}", theta))
    return gamma_opt, found


def _descend(metric: _Metric, name: str, theta: Matrix) -> tuple[SearchStart, Matrix]:
    """Return the result of one start: stabilise, then satisfy the hard goals, then minimise."""
    problem, objective, relative = metric
    stable = minimize(
        problem.stability(), theta, steps=_STABILIZING_STEPS, stop_below=_STABLE_ABSCISSA, relative=relative
    )
    theta = stable.theta
    if stable.value >= 0.0 or (
        not np.isfinite(objective.use_penalty(1.0).goal_values(theta)[0]) and stable.value > _STABLE_ABSCISSA
    ):
        return SearchStart(name=name, target=np.inf, failure=f"{_UNSTABLE}, abscissa {stable.value:.3g}"), theta
    if problem.hard_goals:
        theta, hard = _satisfy(objective, theta)
        if wrong := [f"{goal} {value:.4g} of its limit" for goal, value in hard.items() if not value <= 1.0]:
            return SearchStart(name=name, target=np.inf, failure=", ".join(wrong)), theta
        theta = _trade_off(objective, theta)
    else:
        theta = _find_minimum(objective.use_penalty(1.0), theta, relative=relative)
    target = objective.goal_values(theta)[0]
    failure = "" if np.isfinite(target) else "the target is infinite: white noise passes straight through"
    return SearchStart(name=name, target=target, failure=failure), theta


def _satisfy(objective: PenaltyFunction, theta: Matrix) -> tuple[Matrix, dict[str, float]]:
    """Return parameters that satisfy the hard goals, if found near `theta`, and the goals' values.

    Poles that meet have no gradient. A search that ends at them continues beside them.
    """
    rng = np.random.default_rng(theta.size)
    for _ in range(_RESTARTS + 1):
        theta = _find_minimum(objective.use_penalty(np.inf), theta, stop_below=0.0)
        _, hard = objective.goal_values(theta)
        if max(hard.values(), default=0.0) <= 1.0:
            break
        theta = _perturb(objective, theta, rng)
    _, hard = objective.goal_values(theta)
    return theta, hard


def _find_minimum(
    objective: PenaltyFunction, theta: Matrix, *, stop_below: float = -np.inf, relative: bool = False
) -> Matrix:
    """Return a local minimum near `theta`, or `theta` where the function is infinite."""
    if not np.isfinite(objective.value(theta)):
        return theta
    return minimize(objective, theta, steps=_STEPS, stop_below=stop_below, relative=relative).theta


def _perturb(objective: PenaltyFunction, theta: Matrix, rng: np.random.Generator) -> Matrix:
    """Return parameters off `theta` with stable loops: a search that stopped on a crease continues off it."""
    least, largest = np.log(_PERTURBATIONS)
    for size in np.exp(rng.uniform(least, largest)) * 0.5 ** np.arange(12):
        perturbed = theta * (1.0 + size * rng.normal(size=theta.size))
        if np.isfinite(objective.value(perturbed)):
            return np.asarray(perturbed)
    return theta


def _trade_off(objective: PenaltyFunction, theta: Matrix) -> Matrix:
    """Return parameters with the least target that satisfy the hard goals, from `theta`, which satisfies them.

    Alternates between the minimax function, whose search gets further inside the limits, and the penalty function,
    which goes to their edge.
    """
    best, penalty, least = theta, _PENALTY, objective.goal_values(theta)[0]
    for _ in range(_ROUNDS if np.isfinite(least) else 0):
        before = least
        for minimax in (True, False):
            function = objective.use_minimax(least) if minimax else objective.use_penalty(least, penalty)
            theta = minimize(function, best, steps=_STEPS).theta
            target, hard = objective.goal_values(theta)
            if max(hard.values(), default=0.0) > 1.0:
                penalty *= _PENALTY_GROWTH
            elif target < least:
                best, least = theta, target
        if before - least <= _ROUND_GAIN * least:
            break
    objective.use_penalty(1.0)
    return best


def _worst_peak(problem: Problem, K: Lti) -> Peak:
    return max((hinf_norm(lft(model, K)) for model in problem.models), key=lambda item: item.gain)


def _make_result(
    problem: Problem, objective: PenaltyFunction, theta: Matrix, tried: tuple[SearchStart, ...], gamma_opt: float | None
) -> StructResult:
    K = problem.structure.controller(theta)
    top = _worst_peak(problem, K)
    target, hard = objective.goal_values(theta, checked=True)
    if not np.isfinite(top.gain):
        raise DesignError("rounding spoilt the controller: its closed loop is unstable")
    return StructResult(
        lti=K,
        gamma=top.gain,
        norm=top.gain,
        omega=top.omega,
        checks=_checks(problem, top, hard),
        target=target,
        hard_goals=hard,
        gamma_opt=gamma_opt,
        theta=theta,
        winner=0,
        starts=tried,
        evaluations=objective.evaluations,
        _parts=problem.structure.systems(theta),
    )


def _checks(problem: Problem, top: Peak, hard: dict[str, float]) -> tuple[str, ...]:
    """Return what the closed loops show, a sentence each."""
    count = len(problem.models)
    loops = "The closed loop is" if count == 1 else f"All {count} closed loops are"
    kept = [f"Goal '{name}' is at {value:.4g} of its limit." for name, value in hard.items()]
    return (f"{loops} stable, of norm {top.gain:.6g} at most, up to rounding.", *kept)
