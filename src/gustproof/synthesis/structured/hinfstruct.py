"""Fixed-order, fixed-structure H-infinity synthesis by nonsmooth optimisation: `hinfstruct`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gustproof.errors import DesignError
from gustproof.lti.norms import Peak, hinf_norm
from gustproof.lti.state_space import LinearSystem, Lti, Matrix, as_lti, lft
from gustproof.synthesis.hinf.hinfsyn import hinfsyn
from gustproof.synthesis.structured.blocks import Structure, full_structure
from gustproof.synthesis.structured.goals import GainGoal, Goal
from gustproof.synthesis.structured.loop import augment_plant, close_loop, loop_peak
from gustproof.synthesis.structured.objective import PenaltyFunction, Problem
from gustproof.synthesis.structured.search import minimize

if TYPE_CHECKING:
    import control

_BACKOFFS = (1.1, 1.3, 3.0)
"""[-] levels over the least at which central controllers are made, to be reduced to starts."""
_STABLE_ABSCISSA = -1e-3
"""[rad/s] spectral abscissa at which a loop counts as stable enough to start from."""
_STABILIZING_STEPS, _STEPS, _RESTARTS = 300, 1000, 2
_PERTURBATION = 0.03
"""[-] relative size of the change that is made to all parameters of the best, before its search is tried again."""
_PENALTY, _PENALTY_GROWTH, _ROUNDS = 10.0, 10.0, 12
"""Price of a limit in units of the target, what it is raised by where it is too low, and how often."""
_AGREEMENT = 1e-5
"""[-] two searches that end within this fraction of each other have met."""
_ROUND_GAIN = 1e-3
"""[-] relative progress of a round below which there is no other."""

Progress = Callable[[float, str], None]
"""Told a fraction [0..1] and what is being done."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Start:
    """One start of the search, and where it led."""

    name: str
    """Where it came from: `central 1.1` (a reduced central controller of hinfsyn) or `random 3`."""
    target: float
    """[-] what is minimised, at the end; infinite if no stable loop was found or a limit could not be kept."""
    failed: str
    """Why `target` is infinite; empty if it is not."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StructResult:
    """A controller of the asked structure, its norm, and how it was found."""

    controller: Lti
    """`u = K y` (positive feedback); its states are those of the blocks in their order."""
    gamma: float
    """[-] H-infinity norm from w to z, worst over the models, computed from the closed loops alone."""
    omega: float
    """[rad/s] frequency of that norm."""
    target: float
    """[-] what was minimised: `gamma` unless another goal was given."""
    limits: dict[str, float]
    """[-] each limit's value over its limit, worst over the models, by the goal's name; at most 1."""
    gamma_opt: float | None
    """[-] least norm that any controller of the first model has, from `hinfsyn`; `None` if that is not solvable."""
    blocks: dict[str, Lti]
    """Tuned blocks by name."""
    theta: Matrix
    """(size,) parameters of the structure."""
    winner: int
    """Which of `starts` led here."""
    starts: tuple[Start, ...]
    """Every start in the order in which they were tried."""
    evaluations: int
    """How often the objective was evaluated."""

    @property
    def K(self) -> "control.StateSpace":
        """The controller for python-control, a copy at each call."""
        return self.controller.to_control()

    @property
    def order(self) -> int:
        """Number of controller states."""
        return self.controller.order

    @property
    def norm(self) -> float:
        """The achieved norm [-], which is the level too."""
        return self.gamma


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
    limits: Sequence[Goal] = (),
    progress: Progress = lambda _fraction, _text: None,
) -> StructResult:
    """Return a controller of a given order and structure with a small H-infinity norm from w to z.

    The last `n_meas` outputs of `P` are measured, its last `n_con` inputs are controls; D may be anything. The norm is
    minimised over the parameters by BFGS with analytic gradients from the singular vectors at its peaks, from several
    starts; first the spectral abscissa until the loop is stable. What is found is a local minimum of a problem that is
    not convex: nothing is said about better controllers but `gamma_opt`, which no structure beats. The same seed gives
    the same controller. Cost: some thousand eigenvalue problems of the closed loop's order a start.

    Parameters
    ----------
    P
        Continuous generalised plant, inputs (w, u), outputs (z, y); or several, of which the worst counts.
    n_meas, n_con
        Number of measurements y and controls u.
    order
        Number of controller states without further structure; 0 is static.
    structure
        Tunable blocks; given, `order` is not used.
    starts
        How many; where `hinfsyn` solves the first model, up to three are its central controllers, reduced.
    seed
        Of the random starts.
    soft_goal
        What is minimised instead of the norm from w to z.
    limits
        Goals that are kept while it is.
    progress
        Told the fraction done and the best so far.

    Raises
    ------
    ValueError
        If sizes do not fit, a model is discrete, or an argument is out of range.
    DesignError
        If no start led to a loop that is stable and keeps the limits; each start's failure is named. That none was
        found does not prove that there is none.

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
    structure = full_structure(order, n_meas, n_con) if structure is None else structure
    _check_sizes(models, structure, n_meas, n_con, starts)
    target = GainGoal() if soft_goal is None else soft_goal
    problem = Problem(models=models, structure=structure, target=target, limits=tuple(limits))
    objective = problem.objective()
    gamma_opt, seeds = _starting_points(models[0], structure, starts, seed)
    rng = np.random.default_rng([seed, starts])
    tried: list[Start] = []
    best: Matrix | None = None
    for k in range(len(seeds) + _RESTARTS):
        winner = min(tried, key=lambda start: start.target, default=None)
        least = np.inf if winner is None else winner.target
        if k < len(seeds):
            name, theta = seeds[k]
        elif winner is not None and best is not None and not _is_confirmed(tried):
            name, theta = f"{winner.name}, shaken", _perturb(problem, objective, best, rng)
        else:
            break
        progress(k / (len(seeds) + _RESTARTS), f"{name}; best so far {least:.5g}")
        start, theta = _descend(problem, objective, name, theta)
        tried.append(start)
        if start.target < least:
            best = theta
    progress(1.0, "checked")
    if best is None:
        failures = "; ".join(f"{start.name}: {start.failed}" for start in tried)
        raise DesignError(f"no controller of this structure was found in {len(tried)} starts: {failures}")
    return _make_result(problem, objective, best, tuple(tried), gamma_opt)


def _is_confirmed(tried: list[Start]) -> bool:
    """Return whether two searches met at the least target: there is no better one nearby."""
    targets = sorted(start.target for start in tried)
    return len(targets) > 1 and targets[1] <= (1.0 + _AGREEMENT) * targets[0]


def _check_sizes(models: tuple[Lti, ...], structure: Structure, n_meas: int, n_con: int, starts: int) -> None:
    if starts < 1:
        raise ValueError(f"starts is {starts}, must be at least 1")
    if (structure.n_meas, structure.n_con) != (n_meas, n_con):
        raise ValueError(f"the structure is {structure.n_con} x {structure.n_meas}, K must be {n_con} x {n_meas}")
    for model in models:
        if model.dt:
            raise ValueError("P must be continuous")
        if min(n_meas, n_con, model.n_outputs - n_meas, model.n_inputs - n_con) < 1:
            size = f"{model.n_outputs} x {model.n_inputs}"
            raise ValueError(f"P is {size}: n_meas = {n_meas} and n_con = {n_con} leave no w, z, u or y")


def _starting_points(
    model: Lti, structure: Structure, starts: int, seed: int
) -> tuple[float | None, list[tuple[str, Matrix]]]:
    """Return hinfsyn's least level of the model if there is one, and named parameters to start from."""
    n_meas, n_con = structure.n_meas, structure.n_con
    found: list[tuple[str, Matrix]] = []
    gamma_opt = None
    try:
        for backoff in _BACKOFFS:
            central = hinfsyn(model, n_meas, n_con, backoff=backoff)
            gamma_opt = central.gamma_opt
            theta = structure.fit(central.controller) if structure.order else None
            if theta is not None:
                found.append((f"central {backoff:g}", theta))
    except DesignError:
        pass
    except ValueError:  # a plant without states: nothing to estimate
        pass
    found = found[:starts]
    for k in range(starts - len(found)):
        found.append((f"random {k + 1}", structure.draw(np.random.default_rng([seed, k]))))
    return gamma_opt, found


def _descend(problem: Problem, objective: PenaltyFunction, name: str, theta: Matrix) -> tuple[Start, Matrix]:
    """Return where one start leads: stable first, then within the limits, then small."""
    stable = minimize(problem.stability(), theta, steps=_STABILIZING_STEPS, enough=_STABLE_ABSCISSA)
    theta = stable.theta
    if stable.value >= 0.0 or (
        not np.isfinite(objective.use_penalty(1.0).reached(theta)[0]) and stable.value > _STABLE_ABSCISSA
    ):
        return Start(name=name, target=np.inf, failed=f"unstable, abscissa {stable.value:.3g}"), theta
    if problem.limits:
        theta = _find_minimum(objective.use_penalty(np.inf), theta, enough=0.0)
        _, kept = objective.reached(theta)
        if wrong := [f"{goal} {value:.4g} of its limit" for goal, value in kept.items() if not value <= 1.0]:
            return Start(name=name, target=np.inf, failed=", ".join(wrong)), theta
        theta = _trade_off(objective, theta)
    else:
        theta = _find_minimum(objective.use_penalty(1.0), theta)
    target = objective.reached(theta)[0]
    failed = "" if np.isfinite(target) else "the target is infinite: white noise passes straight through"
    return Start(name=name, target=target, failed=failed), theta


def _find_minimum(objective: PenaltyFunction, theta: Matrix, *, enough: float = -np.inf) -> Matrix:
    """Return a local minimum near `theta`, or `theta` where the function is infinite."""
    return (
        minimize(objective, theta, steps=_STEPS, enough=enough).theta if np.isfinite(objective.value(theta)) else theta
    )


def _perturb(problem: Problem, objective: PenaltyFunction, theta: Matrix, rng: np.random.Generator) -> Matrix:
    """Return parameters a little off `theta`, with stable loops: creases hold up a search, and off them it goes on."""
    for size in _PERTURBATION * 0.5 ** np.arange(12):
        shaken = theta * (1.0 + size * rng.normal(size=theta.size))
        if np.isfinite(objective.value(shaken)):
            return np.asarray(shaken)
    return theta


def _trade_off(objective: PenaltyFunction, theta: Matrix) -> Matrix:
    """Return parameters with the least target among those that keep the limits, from some that do.

    In turns away from the limits' edge, where a search goes further, and down to the edge.
    """
    best, price, least = theta, _PENALTY, objective.reached(theta)[0]
    for _ in range(_ROUNDS if np.isfinite(least) else 0):
        before = least
        for centred in (True, False):
            function = objective.centred(least) if centred else objective.use_penalty(least, price)
            theta = minimize(function, best, steps=_STEPS).theta
            target, kept = objective.reached(theta)
            if max(kept.values()) > 1.0:
                price *= _PENALTY_GROWTH
            elif target < least:
                best, least = theta, target
        if before - least <= _ROUND_GAIN * least:
            break
    objective.use_penalty(1.0)
    return best


def _peak(model: Lti, K: Lti) -> Peak:
    loop = augment_plant(model, K.n_inputs, K.n_outputs, K.order)
    gain, omega = loop_peak(close_loop(loop, np.block([[K.A, K.B], [K.C, K.D]])), [])
    return Peak(gain=gain, omega=omega)


def _make_result(
    problem: Problem, objective: PenaltyFunction, theta: Matrix, tried: tuple[Start, ...], gamma_opt: float | None
) -> StructResult:
    K = problem.structure.controller(theta)
    # where the gain is flat either computation may miss a little of it: the larger one is a norm that is attained
    peaks = [hinf_norm(lft(model, K)) for model in problem.models]
    peaks += [_peak(model, K) for model in problem.models]
    top = max(peaks, key=lambda item: item.gain)
    target, kept = objective.reached(theta)
    if not np.isfinite(top.gain):
        raise DesignError("rounding spoilt the controller: its closed loop is unstable")
    return StructResult(
        controller=K, gamma=top.gain, omega=top.omega, target=target, limits=kept, gamma_opt=gamma_opt,
        blocks=problem.structure.systems(theta), theta=theta, starts=tried, evaluations=objective.evaluations,
        winner=int(np.argmin([start.target for start in tried])),
    )  # fmt: skip
