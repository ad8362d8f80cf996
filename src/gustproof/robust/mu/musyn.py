"""Mu-synthesis: controllers and scalings in turn, each step kept only if the checked bound of its loop falls."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np

from gustproof.errors import DesignError
from gustproof.robust.gain.multipliers import best_multipliers
from gustproof.robust.hinf.checked_controller import CheckedController, keep_names
from gustproof.robust.hinf.hinfsyn import HinfResult, hinfsyn
from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import ComplexMatrix, LinearSystem, Lti, Matrix, as_continuous, as_lti
from gustproof.robust.mu.minimum_phase import fit_least_order, is_positive_real
from gustproof.robust.mu.scaled_plant import constant_filters, dynamic_filters, transform
from gustproof.robust.mu.scalings import best_scalings
from gustproof.robust.mu.singular_value import mu
from gustproof.robust.mu.sweep import Bracket, add_performance_block, sweep
from gustproof.robust.mu.worst_delta import worst_delta
from gustproof.robust.mu.worst_gain import wcgain
from gustproof.robust.uncertain.uncertain_system import Uncertain, lft
from gustproof.robust.uncertain.uncertainty import DeltaBlock, RealBlock, columns, rows

Measure = Literal["mu", "wcgain", "l2gain"]
"""The figure that musyn makes small: see there."""

_ITERATIONS = 30
"""Most iterations by default; the stated tolerance ends nearly all searches before."""
_BACKOFF = 1.005
"""[-] level of each controller over the least one; at the least, poles are unbounded."""
_RESOLUTION = 5e-4
"""[-] relative width at which the search for the least level of a step stops."""
_ACCURACY = 0.005
"""[-] of the upper bound of mu, relative to the least one of D-G scalings."""
_PER_DECADE, _REFINED, _MOST_FREQUENCIES = 2, 16, 100
"""Frequencies of the first grid of scalings, those added in each round, and the most of all."""
_NEAREST = 1e-3
"""[-] relative distance of neighbours between which no frequency is added."""
_FINE = 0.1
"""[-] weighted change of a multiplier's logarithm between neighbours that needs no refinement."""
_FIT_TOLERANCE = 0.01
"""[-] error of a fitted logarithm at the peak of mu that is small enough; less counts where mu is lower."""
_SHARES_OF_G, _LARGEST_PHASE = (1.0, 0.5, 0.0), 1.4
"""Shares of a multiplier's phase that are fitted in turn, and the largest phase [rad]; at pi/2, D would be 0."""
_SHARE_OF_PERFORMANCE = 0.01
"""[-] norm of the performance channels, with the last controller tried, where only stability over the family counts."""
_LEAST_WEIGHT = 0.03
"""[-] weight of a fit where mu is far below its peak."""


_PROOFS = {
    "mu": "D-G scalings hold between frequencies too",
    "wcgain": "D-G scalings hold between frequencies too",
    "l2gain": "one Lyapunov matrix with constant D-G scalings",
}
"""Grounds of each upper bound."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MuStep:
    """One iteration: the controller for the scalings of the loop before, and its loop."""

    level: float
    """[-] least level of any controller with these scalings, by hinfsyn."""
    upper: float
    """[-] checked upper bound of the loop with the controller; infinite if nothing was proved."""
    filter_orders: tuple[int, ...]
    """Orders of the scalings of each channel of Delta; two filters of this order each if G counts."""
    order: int
    """Number of controller states."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class MuResult(CheckedController):
    """A controller with bounds of its measure: `norm` is attained, `gamma` is never exceeded."""

    history: tuple[MuStep, ...]
    """Iterations whose controllers were kept, the first one first: `upper` falls from each to the next."""
    filter_orders: tuple[int, ...]
    """Orders of the scalings of the last step kept; empty if it is the first."""

    @property
    def lower(self) -> float:
        """[-] value of the measure that a member of the family attains."""
        return self.norm

    @property
    def upper(self) -> float:
        """[-] value of the measure that no member exceeds."""
        return self.gamma


def musyn(
    P: Uncertain | LinearSystem,
    n_meas: int,
    n_con: int,
    blocks: tuple[DeltaBlock, ...] = (),
    *,
    order: int = 4,
    measure: Measure = "mu",
    tolerance: float = 0.01,
    iterations: int = _ITERATIONS,
    start: LinearSystem | None = None,
    progress: Callable[[float, str], None] = lambda _fraction, _text: None,
) -> MuResult:
    """Return a controller with a small bound over an uncertain plant, by D-G-K iteration (MATLAB: `musyn`, `dksyn`).

    Each iteration finds the best scalings of the loop, fits them, and designs the controller for the plant so scaled.
    The new loop is kept if its own checked upper bound is lower, whatever the fit promised. The search ends when a
    step brings less than `tolerance`. It finds no global minimum: scalings and controllers are convex in turn only.

    The measures are

    - `mu`: peak of mu with parameters constant in time; below 1, the gain stays below 1 over the unit ball;
    - `wcgain`: worst-case gain over the unit ball, parameters constant in time;
    - `l2gain`: L2 gain over all real parameters of the unit ball that vary at any speed. Scalings are constant, so
      nothing is fitted and the controller has the order of the plant. `certify_gain` proves this bound.

    Parameters
    ----------
    P
        Continuous plant: an `Uncertain` from (w, u) to (z, y), or its `M` with the channels of Delta first.
    n_meas, n_con
        Number of measurements y and controls u, the last channels.
    blocks
        Blocks of Delta, if `P` is no `Uncertain`.
    order
        Largest order of the filter of each scaling; the least one that fits within 1 % is taken. The controller has
        the states of the plant and of all filters: one for each input and output of Delta.
    measure
        See above.
    tolerance
        [-] relative fall of the bound below which the search ends.
    iterations
        Most steps after the start; they alone limit the search, not time. Whatever ends it, the last controller kept is
        returned, with both bounds of its own loop. One that is passed as `start` continues the search.
    start
        Controller to start from. By default the better of two H-infinity controllers, or for the last two measures
        one of a small mu of stability if neither has a finite bound.
    progress
        Called before each step, and at the end, with the share of `iterations` done and the bound so far as a text. An
        exception that it raises ends the search without a result.

    Raises
    ------
    ValueError
        If sizes do not fit, the plant is discrete or has no blocks, or a value is out of range. For `l2gain`, also if a
        block is no real parameter.
    DesignError
        If the first problem is ill posed, or no start has a finite bound.

    References
    ----------
    J. C. Doyle, Structured uncertainty in control system design, CDC 1985, 260-265. P. M. Young, Controller design with
    real parametric uncertainty, Int. J. of Control 65 (1996), 469-509. Multipliers as passive channels: C. A. Desoer,
    M. Vidyasagar, Feedback Systems: Input-Output Properties, Academic Press 1975, section VI.9.

    Examples
    --------
    >>> import numpy as np
    >>> from control import ss
    >>> from gustproof import musyn, ureal
    >>> gain = ureal("gain", range=(0.5, 1.5))
    >>> lag = ss(-0.1, [1.0, 0.0, 1.0], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 0.2], [0, 0.1, 0]])
    >>> actuated = np.diag([1.0, 1.0, 0.0]) + np.diag([0.0, 0.0, 1.0])[:, 2:] @ gain @ np.array([[0.0, 0.0, 1.0]])
    >>> result = musyn(lag @ actuated, 1, 1, measure="l2gain", tolerance=0.05)
    >>> f"gain {result.lower:.2f} to {result.upper:.2f}, at the start {result.history[0].upper:.2f}"
    'gain 0.31 to 0.31, at the start 0.34'
    """
    plant = _checked_plant(P, n_meas, n_con, blocks)
    if order < 0 or iterations < 0 or not 0.0 < tolerance < 1.0 or measure not in ("mu", "wcgain", "l2gain"):
        given = f"order {order}, iterations {iterations}, tolerance {tolerance} or measure '{measure}'"
        raise ValueError(f"{given} is out of range")
    problem = _Problem(plant=plant, n_meas=n_meas, n_con=n_con, measure=measure)
    if start is None:
        controller, first = _automatic_start(problem, order, tolerance)
    else:
        controller, first = _best_start(problem, [_Candidate(as_continuous("start", start))])
    history = [first]
    for number in range(iterations):
        found = history[-1]
        progress(number / iterations, f"{measure} {found.upper:.4g}, controller of order {found.order}")
        tried = _step(problem, controller, found.upper, order)
        if tried is None:
            break
        controller, step = tried
        history.append(step)
        if step.upper > (1.0 - tolerance) * found.upper:
            break
    progress(1.0, f"{measure} {history[-1].upper:.4g}")
    return keep_names(_result(problem, controller, tuple(history)), P)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Problem:
    """The plant and what is to be made small."""

    plant: Uncertain
    """Plant from (w, u) to (z, y)."""
    n_meas: int
    """Number of measurements y."""
    n_con: int
    """Number of controls u."""
    measure: Measure
    """Figure to make small."""

    @property
    def channels(self) -> tuple[int, int]:
        """Widths (z, w) of the transformed channels: of Delta, and of the performance block unless it is constant."""
        M = self.plant.M
        if self.measure == "l2gain":
            return self.plant.n_z, self.plant.n_w
        return M.n_outputs - self.n_meas, M.n_inputs - self.n_con

    def design(self, filters: Lti, level: float, gamma: float | None = None) -> HinfResult:
        """Return the controller of the plant scaled by filters, at a level of the measure."""
        M = self.plant.M
        scale = np.ones(M.n_inputs)
        scale[0 if self.measure == "mu" else self.plant.n_w : M.n_inputs - self.n_con] /= level
        scaled = Lti(A=M.A, B=M.B * scale, C=M.C, D=M.D * scale)
        return hinfsyn(transform(scaled, filters, *self.channels), self.n_meas, self.n_con, gamma=gamma)

    def least_level(self, filters: Lti, start: float) -> float:
        """Return the least level at which the scaled plant has a norm below 1; the norm falls with the level.

        Raises
        ------
        DesignError
            If 60 trials did not settle it.
        """
        low, high, level = 0.0, math.inf, start
        for number in range(60):
            reached = self.design(filters, level).gamma_opt
            low, high = (low, level) if reached < 1.0 else (level, high)
            if high < (1.0 + _RESOLUTION) * low:
                return high
            # where all channels scale, the level times its norm is the least one: two tries bracket it
            guess = reached * level * (1.0 + math.copysign(0.4 * _RESOLUTION, 1.0 - reached))
            if number < 2 and low < guess < high:
                level = guess
            else:
                level = math.sqrt(max(low, 0.25 * high) * high) if math.isfinite(high) else 2.0 * level
        raise DesignError("the level of the scaled plant did not settle")


def _checked_plant(P: Uncertain | LinearSystem, n_meas: int, n_con: int, blocks: tuple[DeltaBlock, ...]) -> Uncertain:
    """Return the plant as an `Uncertain`, or raise an error that names what does not fit."""
    if isinstance(P, Uncertain) and blocks:
        raise ValueError("the plant is uncertain already: give no blocks")
    plant = P if isinstance(P, Uncertain) else Uncertain(M=as_lti(P), blocks=blocks)
    if plant.M.dt:
        raise ValueError(f"P is discrete, dt = {plant.M.dt} s, must be continuous")
    if not plant.blocks:
        raise ValueError("P has no blocks: nothing is uncertain, use hinfsyn")
    if not (0 < n_meas <= plant.n_outputs and 0 < n_con <= plant.n_inputs):
        raise ValueError(f"P is {plant.n_outputs} x {plant.n_inputs}: it has no {n_meas} y and {n_con} u")
    return plant


class _Candidate(NamedTuple):
    """A controller to start from, and what is known of it."""

    controller: Lti
    level: float = math.inf
    """[-] least level of its design."""
    bound: float = math.inf
    """[-] bound of the measure, if its design proves one."""


def _automatic_start(problem: _Problem, order: int, tolerance: float) -> tuple[Lti, MuStep]:
    """Return the better controller of those for all channels of Delta and for none, or else one of a small mu.

    With all channels, the norm is a bound of mu. The other measures may have no finite bound with either controller.
    """
    candidates, failures = [], []
    for part in (problem.plant.M, problem.plant.nominal_system()):
        try:
            found = hinfsyn(part, problem.n_meas, problem.n_con, backoff=_BACKOFF)
        except (DesignError, ValueError) as error:  # ValueError: no w or z without the channels of Delta
            failures.append(str(error))
            continue
        known = found.norm if problem.measure == "mu" and part is problem.plant.M else math.inf
        candidates.append(_Candidate(found.lti, found.gamma_opt, known))
    if not candidates:
        raise DesignError(failures[0])
    try:
        return _best_start(problem, candidates)
    except DesignError:
        if problem.measure == "mu":
            raise
        # with a small share of the performance, mu is about stability over the family
        M, weight = problem.plant.M, np.ones((problem.plant.M.n_outputs, 1))
        weight[problem.plant.n_z : M.n_outputs - problem.n_meas] = _SHARE_OF_PERFORMANCE / candidates[-1].level
        modest = replace(problem.plant, M=Lti(A=M.A, B=M.B, C=weight * M.C, D=weight * M.D))
        steady = musyn(modest, problem.n_meas, problem.n_con, order=order, tolerance=tolerance)
        return _best_start(problem, [_Candidate(steady.lti)])


def _best_start(problem: _Problem, candidates: list[_Candidate]) -> tuple[Lti, MuStep]:
    """Return the candidate with the least bound, and its step.

    Raises
    ------
    DesignError
        If no bound is finite.
    """
    loops = [_close_loop(problem.plant, each.controller) for each in candidates]
    bounds = [
        min(each.bound, _upper_bound(loop, problem.measure)) for each, loop in zip(candidates, loops, strict=True)
    ]
    best = int(np.argmin(bounds))
    if not math.isfinite(bounds[best]):
        raise DesignError(f"no start has a finite bound of {problem.measure}: take less uncertainty")
    controller, level, _ = candidates[best]
    return controller, MuStep(level=level, upper=bounds[best], filter_orders=(), order=controller.order)


# A step begins with the loop that the one before ended with, and semidefinite programs take most of its time.
_close_loop, _best_multipliers = lru_cache(4)(lft), lru_cache(4)(best_multipliers)


def _upper_bound(loop: Uncertain, measure: Measure) -> float:
    """Return a bound of the measure from the loop alone; infinite if there is none."""
    if measure == "l2gain":
        multipliers = _best_multipliers(loop)
        return math.inf if multipliers is None else multipliers.level
    return sweep(loop.M, _all_blocks(loop), gain=measure == "wcgain", accuracy=_ACCURACY)[0]


def _step(problem: _Problem, controller: Lti, upper: float, order: int) -> tuple[Lti, MuStep] | None:
    """Return a controller with a lower bound, for the scalings of a loop, and its step; `None` if none was found."""
    loop = _close_loop(problem.plant, controller)
    for filters, orders in _filters(loop, problem.measure, upper, order):
        try:
            level = problem.least_level(filters, upper)
            found = problem.design(filters, _BACKOFF * level, gamma=1.0).lti
            closed = _close_loop(problem.plant, found)
        except (DesignError, ValueError, np.linalg.LinAlgError):
            continue  # rounding, or filters that are not well posed
        if not closed.M.is_stable():
            continue
        reached = _upper_bound(closed, "l2gain") if problem.measure == "l2gain" else _BACKOFF * level
        if reached < upper:
            return found, MuStep(level=level, upper=reached, filter_orders=orders, order=found.order)
    return None


def _filters(loop: Uncertain, measure: Measure, level: float, order: int) -> Iterator[tuple[Lti, tuple[int, ...]]]:
    """Yield filters of the best scalings of a loop, (z, w) to (z, w), and their orders; later ones have less G.

    Fitted filters count only if their own D is positive at every frequency.
    """
    if measure == "l2gain":
        multipliers = _best_multipliers(loop)
        if multipliers is not None:
            yield constant_filters(multipliers.D, multipliers.G), (0,) * len(multipliers.D)
        return
    blocks = _single_blocks(_all_blocks(loop))
    # mu at the level beta is that of M / beta at the level 1, whose G is G / beta
    omega, values, levels = _scalings_over_frequency(
        loop.M, blocks, gain=measure == "wcgain", scale=level if measure == "mu" else 1.0
    )
    weight = np.clip(levels / np.max(levels), _LEAST_WEIGHT, 1.0)
    logarithms = np.log(values.T)
    for share in _SHARES_OF_G if np.any(values.imag) else (0.0,):
        phase = np.clip(share * logarithms.imag, -_LARGEST_PHASE, _LARGEST_PHASE)
        factors = [
            fit_least_order(omega, target, weight, most=order, tolerance=_FIT_TOLERANCE)
            for target in logarithms.real + 1j * phase
        ]
        if all(is_positive_real(*pair) for pair in factors):
            yield dynamic_filters(factors, [block.shape for block in blocks]), tuple(a.order for a, _ in factors)


def _scalings_over_frequency(
    M: Lti, blocks: tuple[DeltaBlock, ...], *, gain: bool, scale: float
) -> tuple[Matrix, ComplexMatrix, Matrix]:
    """Return frequencies (k,), multipliers D + j G / `scale` of each block, (k, blocks), and levels (k,).

    The last block's D is 1. A coarse grid is refined where multipliers change most.
    """
    speeds = np.abs(M.poles())
    fast = float(np.max(speeds))
    low, high = max(float(np.min(speeds)), 1e-9 * fast) / 30.0, 10.0 * fast
    found: dict[float, tuple[ComplexMatrix, float]] = {}
    pending = np.geomspace(low, high, round(_PER_DECADE * math.log10(high / low))).tolist()
    while pending:
        for omega, response in zip(pending, M.response(pending), strict=True):
            best = best_scalings(response, blocks, gain=gain, accuracy=_ACCURACY)
            found_here = [
                best.D_w[w.start, w.start].real + 1j * best.G[w.start, z.start].real / scale
                for w, z in zip(rows(blocks), columns(blocks), strict=True)
            ]
            found[omega] = np.array(found_here) / found_here[-1].real, best.level(response)
        grid = np.array(sorted(found))
        values, levels = np.array([found[x][0] for x in grid]), np.array([found[x][1] for x in grid])
        weight = np.clip(levels / np.max(levels), _LEAST_WEIGHT, 1.0)
        change = np.max(np.abs(np.diff(np.log(values), axis=0)), axis=1) * np.maximum(weight[1:], weight[:-1])
        # best scalings of parameters may jump with frequency: no grid shows more of a jump than that
        change[grid[1:] < (1.0 + _NEAREST) * grid[:-1]] = 0.0
        worst = np.argsort(-change)[: max(min(_REFINED, _MOST_FREQUENCIES - grid.size), 0)]
        pending = [float(np.sqrt(grid[k] * grid[k + 1])) for k in worst if change[k] > _FINE]
    return grid, values, levels


def _all_blocks(loop: Uncertain) -> tuple[DeltaBlock, ...]:
    """Return the blocks of a loop, with that of performance if it has inputs and outputs."""
    return add_performance_block(loop) if loop.n_inputs and loop.n_outputs else loop.blocks


def _single_blocks(blocks: tuple[DeltaBlock, ...]) -> tuple[DeltaBlock, ...]:
    """Return the blocks with each repeated parameter as so many parameters, which can do more than it."""
    single: list[DeltaBlock] = []
    for block in blocks:
        if isinstance(block, RealBlock):
            single += [replace(block, name=f"{block.name} {k}", repeats=1) for k in range(block.repeats)]
        else:
            single.append(block)
    return tuple(single)


def _result(problem: _Problem, controller: Lti, history: tuple[MuStep, ...]) -> MuResult:
    """Return the controller with both bounds, from its loop alone."""
    loop, last = lft(problem.plant, controller), history[-1]
    if problem.measure == "l2gain":
        bracket, upper = _bad_member(loop, last.upper), last.upper
    else:
        bracket = mu(loop) if problem.measure == "mu" else wcgain(loop, accuracy=0.02, boxes=1)
        upper = min(bracket.upper, last.upper)
    if not bracket.lower <= upper:
        raise DesignError(f"rounding spoilt the bounds: {bracket.lower:.6g} is attained, {upper:.6g} was proved")
    return MuResult(
        lti=controller,
        gamma=upper,
        norm=bracket.lower,
        omega=bracket.omega,
        checks=(
            "the loop is stable at Delta = 0",
            f"{problem.measure} of the loop is at most {upper:.6g}: {_PROOFS[problem.measure]}",
            f"a member of the family attains {bracket.lower:.6g} at {bracket.omega:.6g} rad/s",
        ),
        history=history,
        filter_orders=last.filter_orders,
    )


def _bad_member(loop: Uncertain, upper: float) -> Bracket:
    """Return the largest gain found among members with constant parameters, which vary at any speed too."""
    peak = hinf_norm(loop.nominal_system())
    speeds = np.abs(loop.M.poles())
    tried = [0.0 if math.isinf(peak.omega) else peak.omega, *np.geomspace(np.min(speeds), np.max(speeds), 4)]
    worst = max((worst_delta(M, loop.blocks) for M in loop.M.response(tried)), key=lambda found: found.gain)
    delta = worst.parts(loop.blocks)
    member = hinf_norm(loop.member(delta))
    if member.gain < peak.gain:
        return Bracket(lower=peak.gain, upper=upper, omega=peak.omega, delta={})
    return Bracket(lower=member.gain, upper=upper, omega=member.omega, delta=delta)
