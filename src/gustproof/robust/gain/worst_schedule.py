"""Lower bounds of a gain over varying parameters: simulated schedules, switching or in triangle waves."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from gustproof.robust.lti.state_space import Matrix, gain
from gustproof.robust.uncertain.reduction import matrix_of_parameters
from gustproof.robust.uncertain.uncertain_system import Uncertain

Order = NDArray[np.int64]
Systems = tuple[Matrix, Matrix, Matrix, Matrix]

_STEP = 0.02
"""[s] least time for which a vertex of Delta is held; the input is constant in it."""
_SWEEPS = 3
"""[-] power iterations of the input between two improvements of the schedule."""
_CONVERGENCE = 1e-4
"""[-] relative growth of the gain below which the search ends."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WorstSchedule:
    """A history of Delta and the gain that it reaches from rest."""

    gain: float
    """[-] L2 norm of z divided by that of w, in simulation."""
    delta: Matrix
    """(k, blocks) [-] normalised parameters, held over each step of `dt`."""
    dt: float
    """[s] step."""


def worst_schedule(loop: Uncertain, *, duration: float = 60.0, rounds: int = 24, seed: int = 0) -> WorstSchedule:
    """Return a bad schedule of vertices of Delta; its gain is a lower bound over parameters of any speed.

    Ascent from a random start. The input comes from power iteration of the loop and its adjoint. Each step takes the
    vertex with the largest product of the adjoint and the next state. Cost `rounds` * 6 simulations.

    Parameters
    ----------
    loop
        Continuous, with real parameters only.
    duration
        [s] length of the schedule; ignoring the response after it can only lower the gain.
    rounds
        Largest number of improvements of the schedule.
    seed
        Seed of the random start.
    """
    corners = np.array(list(_signs(len(loop.blocks))))
    A, B, C, D = _systems(loop, corners)
    steps = round(duration / _STEP)
    rng = np.random.default_rng(seed)
    order = np.repeat(rng.integers(len(corners), size=steps // 25 + 1), 25)[:steps]  # half a second each, to start
    w = rng.normal(size=(steps, B.shape[2]))
    best, best_order = 0.0, order
    for _ in range(rounds):
        for _ in range(_SWEEPS):
            x, z = _simulate_forward(A, B, C, D, order, w)
            gain = float(np.linalg.norm(z) / np.linalg.norm(w))
            adjoint, w_next = _simulate_adjoint(A, B, C, D, order, z)
            played, w = w, w_next / np.linalg.norm(w_next)
        if gain < (1.0 + _CONVERGENCE) * best:
            break
        best, best_order = gain, order
        pulled, pushed = (np.einsum("ki,vij->kvj", adjoint, M, optimize=True) for M in (A, B))
        order = np.argmax((pulled @ x[:-1, :, None] + pushed @ played[:, :, None])[:, :, 0], axis=1)
    return WorstSchedule(gain=best, delta=corners[best_order], dt=_STEP)


def worst_triangle_schedule(
    loop: Uncertain, speeds: Sequence[float | None], *, duration: float = 60.0
) -> WorstSchedule:
    """Return the worst of some histories of Delta that keep `speeds`; its gain is a lower bound.

    Each parameter with a bound in `speeds` [1/s] stays at a corner, or follows a triangle wave from -1 to 1. Waves run
    at the least of the speeds or slower, in phase with the first one or a quarter period late. The others stay at 0.
    Ramps are sampled at the middle of each step. Cost 100 simulations for two slow parameters.
    """
    slow = [i for i, speed in enumerate(speeds) if speed is not None]
    fastest = min(speed for speed in speeds if speed is not None)
    steps = round(duration / _STEP)
    start = np.random.default_rng(0).normal(size=(steps, loop.n_inputs))
    histories = [np.array([signs]) for signs in _signs(len(slow))]
    for slower, *late in itertools.product((1.0, 2.0, 4.0), *[(0.0, 0.25)] * (len(slow) - 1)):
        period = math.ceil(4.0 * slower / fastest / _STEP)
        turns = (np.arange(min(period, steps)) + 0.5)[:, None] / period + np.array([0.0, *late])
        histories.append(1.0 - 4.0 * np.abs((turns + 0.25) % 1.0 - 0.5))
    found = []
    for history in histories:
        delta = np.zeros((len(history), len(loop.blocks)))
        delta[:, slow] = history
        found.append(
            (*_power_iterate(_systems(loop, delta), np.arange(steps) % len(delta), start, rounds=_SWEEPS), delta)
        )
    _, w, delta = max(found, key=lambda one: one[0])
    order = np.arange(steps) % len(delta)
    gain, _ = _power_iterate(_systems(loop, delta), order, w, rounds=4 * _SWEEPS)
    return WorstSchedule(gain=gain, delta=delta[order], dt=_STEP)


def _power_iterate(systems: Systems, order: Order, w: Matrix, *, rounds: int) -> tuple[float, Matrix]:
    """Return the gain and the input that power iteration of the loop and its adjoint reaches from the input `w`."""
    gain = 0.0
    for _ in range(rounds):
        _, z = _simulate_forward(*systems, order, w)
        gain = float(np.linalg.norm(z) / np.linalg.norm(w))
        _, played = _simulate_adjoint(*systems, order, z)
        w = played / np.linalg.norm(played)
    return gain, w


def _systems(loop: Uncertain, deltas: Matrix) -> Systems:
    """Return A, B, C and D, each (k, ...), of the loop over a step with held input at each of `deltas` (k, blocks).

    Outputs are rotated and weighted: the square of C x + D w is the mean of that of the loop's output in the step.
    """
    n, m = loop.M.order, loop.n_inputs
    # an uncertain matrix has its values at all deltas at once
    static = matrix_of_parameters(loop.M, loop.n_z, loop.n_w)
    names = [block.name for block in loop.blocks]
    values = Uncertain(M=gain(static), blocks=loop.blocks).matrices(dict(zip(names, deltas.T, strict=True)))
    generators = np.zeros((len(values), n + m, n + m))
    generators[:, :n] = _STEP * values[:, :n]
    held, mean = _integrate(generators, values[:, n:])
    return held[:, :n, :n], held[:, :n, n:], mean[:, :, :n], mean[:, :, n:]


def _integrate(generators: Matrix, outputs: Matrix) -> tuple[Matrix, Matrix]:
    """Return exp(G) of each G (k, n, n), and R with R^T R = int_0^1 exp(G t)^T H^T H exp(G t) dt for its H (k, p, n).

    Gauss's rule gives the integral over a small part of the step, and doubling extends it to the whole. All terms are
    positive semidefinite, so nothing cancels.
    """
    halvings = max(math.ceil(math.log2(max(float(np.abs(generators).sum(axis=2).max()), 1.0))), 0)
    part = 0.5**halvings
    nodes, weights = np.polynomial.legendre.leggauss(8)
    integral = np.zeros_like(generators)
    for node, weight in zip(nodes, weights, strict=True):
        seen = outputs @ scipy.linalg.expm(0.5 * part * (1.0 + node) * generators)
        integral += 0.5 * part * weight * seen.transpose(0, 2, 1) @ seen
    step = scipy.linalg.expm(part * generators)
    for _ in range(halvings):
        integral += step.transpose(0, 2, 1) @ integral @ step
        step = step @ step
    squares, vectors = np.linalg.eigh(integral)
    return step, np.sqrt(np.maximum(squares, 0.0))[:, :, None] * vectors.transpose(0, 2, 1)


def _signs(blocks: int) -> "itertools.product[tuple[float, ...]]":
    return itertools.product((-1.0, 1.0), repeat=blocks)


def _simulate_forward(A: Matrix, B: Matrix, C: Matrix, D: Matrix, order: Order, w: Matrix) -> tuple[Matrix, Matrix]:
    """Return the states (k + 1, n) and outputs (k, p) of the schedule `order` (k,) from rest."""
    x = _accumulate(A, order, np.einsum("kij,kj->ki", B[order], w))
    return x, np.einsum("kij,kj->ki", C[order], x[:-1]) + np.einsum("kij,kj->ki", D[order], w)


def _simulate_adjoint(A: Matrix, B: Matrix, C: Matrix, D: Matrix, order: Order, z: Matrix) -> tuple[Matrix, Matrix]:
    """Return the adjoint (k, n) of each step's next state and the adjoint's output (k, m)."""
    read = np.einsum("kij,ki->kj", C[order], z)
    after = np.ascontiguousarray(_accumulate(A.transpose(0, 2, 1), order[:0:-1], read[:0:-1])[::-1])
    return after, np.einsum("kij,ki->kj", B[order], after) + np.einsum("kij,ki->kj", D[order], z)


def _accumulate(A: Matrix, order: Order, driven: Matrix) -> Matrix:
    """Return the states (k + 1, n) from rest of the steps A[order[i]], each with an addend of `driven` (k, n)."""
    steps, x = list(A), np.zeros((len(order) + 1, A.shape[1]))
    now, *rest = x
    for v, part, after in zip(order.tolist(), driven, rest, strict=True):
        steps[v].dot(now, after)
        after += part
        now = after
    return x
