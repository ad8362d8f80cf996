"""Fixed-order, fixed-structure H-infinity synthesis by non-smooth optimisation: `hinfstruct`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gustproof.errors import DesignError
from gustproof.lti.bilinear import bilinear_transform, tustin
from gustproof.lti.norms import Peak, hinf_norm
from gustproof.lti.state_space import LinearSystem, Lti, Matrix, as_lti, lft
from gustproof.synthesis.checked_controller import CheckedController
from gustproof.synthesis.hinf.hinfsyn import hinfsyn
from gustproof.synthesis.structured.blocks import Structure, full_structure
from gustproof.synthesis.structured.goals import GainGoal, Goal
from gustproof.synthesis.structured.loop import augment_plant, close_loop, loop_peak
from gustproof.synthesis.structured.objective import PenaltyFunction, Problem
from gustproof.synthesis.structured.search import minimize

_BACKOFFS = (1.1, 1.3, 3.0)
"""[-] levels over the least of the central controllers that are reduced to starting points."""
_STABLE_ABSCISSA = -1e-3
"""[rad/s] spectral abscissa below which a loop is stable enough to start from."""
_STABILIZING_STEPS, _STEPS, _RESTARTS = 300, 1000, 2
_SIZES = (1.0, 0.1, 10.0, 0.01, 100.0)
"""[-] sizes of random starts in turn: the best of several local minima may have small or large parameters."""
_PERTURBATIONS = (1e-3, 1.0)
"""[-] least and largest relative size of the random change to the best parameters before its search is repeated."""
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

_BALANCED, _NEAR = ", balanced", ", near it"
"""Ends of the names of starts in balanced units, and of starts near the best."""

Progress = Callable[[float, str], None]
"""Callback for the fraction done [0..1] and a text on the current work."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Start:
    """One start of the search, and its result."""

    name: str
    """Origin: `central 1.1` (a reduced central controller of hinfsyn) or `random 3`."""
    target: float
    """[-] final target; infinite if no stable loop was found or a hard goal could not be satisfied."""
    failure: str
    """Reason for an infinite `target`; empty if it is finite."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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
    blocks: dict[str, Lti]
    """Tuned blocks by name."""
    theta: Matrix
    """(size,) parameters of the structure."""
    winner: int
    """Index in `starts` of this result."""
    starts: tuple[Start, ...]
    """All starts in the order of the search."""
    evaluations: int
    """Number of evaluations of the objective."""


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
        others are random; they take turns in size, and in units of 1 or those of the plant's balance.
    seed
        Seed of the random starts.
    soft_goal
        Goal to minimise instead of the norm from w to z.
    hard_goals
        Goals to satisfy, from `gustproof.synthesis.structured.goals`: margins, roll-off, decay, pole radius, |K|.
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
    target = GainGoal() if soft_goal is None else soft_goal
    problem = Problem(models=models, structure=structure, target=target, hard_goals=tuple(hard_goals))
    return search_problem(problem, starts=starts, seed=seed, progress=progress)


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
    search.run(points, progress)
    progress(1.0, "checked")
    if search.best is None:
        failures = "; ".join(f"{start.name}: {start.failure}" for start in search.tried)
        raise DesignError(f"no controller of this structure was found in {len(search.tried)} starts: {failures}")
    return search.result(gamma_opt)


class _Search:
    """All starts of one problem in two metrics, and the best parameters found."""

    def __init__(self, problem: Problem, rng: np.random.Generator) -> None:
        # steepest descent depends on the units of the parameters; where one choice creeps, the other may run
        balanced = replace(problem, unit=problem.balanced_unit())
        self._metrics = tuple((each, each.objective()) for each in (problem, balanced))
        self._rng = rng
        self.tried: list[Start] = []
        self.best: Matrix | None = None

    @property
    def least(self) -> float:
        """The least target so far; infinite if all failed."""
        return min((start.target for start in self.tried), default=np.inf)

    def run(self, points: list[tuple[str, Matrix]], progress: Progress) -> None:
        """Search from each of `points`, then near the best until two agree or that helps no longer."""
        limit = _RESTARTS * len(points)
        for k, (name, theta) in enumerate(points):
            progress(k / (len(points) + limit), f"{name}; best so far {self.least:.5g}")
            self._start(name, theta, balanced=name.endswith(_BALANCED))
        failed = 0
        for k in range(_LUCK * limit):
            if failed == limit or self.best is None or _is_confirmed(self.tried):
                break
            winner, before = min(self.tried, key=lambda start: start.target), self.least
            progress((len(points) + failed) / (len(points) + limit), f"near {winner.name}; best so far {before:.5g}")
            theta = _perturb(self._metrics[0][1], self.best, self._rng)
            self._start(f"{winner.name.removesuffix(_NEAR)}{_NEAR}", theta, balanced=k % 2 == 1)
            failed += self.least > (1.0 - _ROUND_GAIN) * before

    def _start(self, name: str, theta: Matrix, *, balanced: bool) -> None:
        problem, objective = self._metrics[balanced]
        unit = 1.0 if problem.unit is None else problem.unit
        before = self.least
        start, scaled = _descend(problem, objective, name, theta / unit)
        self.tried.append(start)
        if start.target < before:
            self.best = scaled * unit

    def result(self, gamma_opt: float | None) -> StructResult:
        """Return the best, checked."""
        assert self.best is not None
        problem, objective = self._metrics[0]
        evaluations = sum(each.evaluations for _, each in self._metrics)
        return replace(
            _make_result(problem, objective, self.best, tuple(self.tried), gamma_opt), evaluations=evaluations
        )


def _is_confirmed(tried: list[Start]) -> bool:
    """Return whether two searches agree on the least target, so that no better one is nearby."""
    targets = sorted(start.target for start in tried)
    return len(targets) > 1 and targets[1] <= (1.0 + _AGREEMENT) * targets[0]


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
        if min(n_meas, n_con, model.n_outputs - n_meas, model.n_inputs - n_con) < 1:
            size = f"{model.n_outputs} x {model.n_inputs}"
            raise ValueError(f"P is {size}: n_meas = {n_meas} and n_con = {n_con} leave no w, z, u or y")


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
            K = tustin(central.controller, model.dt) if model.dt else central.controller
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


def _descend(problem: Problem, objective: PenaltyFunction, name: str, theta: Matrix) -> tuple[Start, Matrix]:
    """Return the result of one start: stabilise, then satisfy the hard goals, then minimise.

    The entries of a static gain, in units of 1, may be of very different sizes.
    """
    relative = problem.unit is None and not problem.structure.order
    stable = minimize(
        problem.stability(), theta, steps=_STABILIZING_STEPS, stop_below=_STABLE_ABSCISSA, relative=relative
    )
    theta = stable.theta
    if stable.value >= 0.0 or (
        not np.isfinite(objective.use_penalty(1.0).goal_values(theta)[0]) and stable.value > _STABLE_ABSCISSA
    ):
        return Start(name=name, target=np.inf, failure=f"unstable, abscissa {stable.value:.3g}"), theta
    if problem.hard_goals:
        theta, hard = _satisfy(objective, theta)
        if wrong := [f"{goal} {value:.4g} of its limit" for goal, value in hard.items() if not value <= 1.0]:
            return Start(name=name, target=np.inf, failure=", ".join(wrong)), theta
        theta = _trade_off(objective, theta)
    else:
        theta = _find_minimum(objective.use_penalty(1.0), theta, relative=relative)
    target = objective.goal_values(theta)[0]
    failure = "" if np.isfinite(target) else "the target is infinite: white noise passes straight through"
    return Start(name=name, target=target, failure=failure), theta


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


def _loop_peak(model: Lti, K: Lti) -> Peak:
    P = bilinear_transform(model) if model.dt else model
    loop = augment_plant(P, K.n_inputs, K.n_outputs, K.order, model.dt)
    peak = loop_peak(close_loop(loop, np.block([[K.A, K.B], [K.C, K.D]])), [])
    return replace(peak, omega=2.0 / K.dt * float(np.arctan(0.5 * peak.omega * K.dt))) if K.dt else peak


def _make_result(
    problem: Problem, objective: PenaltyFunction, theta: Matrix, tried: tuple[Start, ...], gamma_opt: float | None
) -> StructResult:
    K = problem.structure.controller(theta)
    # where the gain is flat either computation may fall slightly short; both gains are attained, so take the larger
    peaks = [hinf_norm(lft(model, K)) for model in problem.models]
    peaks += [_loop_peak(model, K) for model in problem.models]
    top = max(peaks, key=lambda item: item.gain)
    target, hard = objective.goal_values(theta)
    if not np.isfinite(top.gain):
        raise DesignError("rounding spoilt the controller: its closed loop is unstable")
    return StructResult(
        controller=K,
        gamma=top.gain,
        norm=top.gain,
        omega=top.omega,
        checks=_checks(problem, top, hard),
        target=target,
        hard_goals=hard,
        gamma_opt=gamma_opt,
        blocks=problem.structure.systems(theta),
        theta=theta,
        winner=int(np.argmin([start.target for start in tried])),
        starts=tried,
        evaluations=objective.evaluations,
    )


def _checks(problem: Problem, top: Peak, hard: dict[str, float]) -> tuple[str, ...]:
    """Return what the closed loops show, a sentence each."""
    count = len(problem.models)
    loops = "The closed loop is" if count == 1 else f"All {count} closed loops are"
    kept = [f"Goal '{name}' is at {value:.4g} of its limit." for name, value in hard.items()]
    return (f"{loops} stable, of norm {top.gain:.6g} at most, up to rounding.", *kept)
