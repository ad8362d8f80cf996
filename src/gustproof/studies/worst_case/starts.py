"""Starting points of the search for the worst disturbance, in a cube that represents moments and vehicles.

Starts are random, or come from simulated step responses of the loop about hover:

- Bad inputs of the linear loop: held moments, and moments at the frequency and in the direction of the largest singular
  value.
- Its worst inputs: bang-bang moments with the time-reversed sign of each axis's own impulse response.
- Two axes in phase, so that an angle and a rate rise and fall together. Their product, the second-order term of the
  Euler kinematics (theta r in phi-dot), then has a mean that turns the third axis steadily.
- Dryden turbulence whose peak fills the budget.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MAX_OMEGA = 30.0
"""[rad/s] fastest moment; above it, the angle caused by a moment falls with the square of the frequency."""
RATE, PHASES, AMPLITUDES, INERTIA, LAG, SIZE = 0, slice(1, 4), slice(4, 7), slice(7, 10), 10, 11
"""Positions of a point's coordinates, and their number."""
_RECTIFICATIONS = (
    (1, 2, 0, "theta and r into phi"),
    (0, 2, 1, "phi and r into theta"),
    (0, 1, 2, "phi and q into psi"),
)


class Point(NamedTuple):
    """A disturbance and a vehicle: a fixed pattern, and a point of the unit cube that the search moves."""

    start: str
    """Name of the starting point."""
    multiples: tuple[int, int, int]
    """Rate of each axis over the common rate; 0 for a held moment."""
    square: bool
    """True if the moments are bang-bang."""
    x: Array
    """(11,) 0..1: common rate (logarithmic), phases (3), amplitudes (3), inertia (3), lag."""


def starts(steps: Array, budget: Array, dt: float, slowest: float) -> Iterator[Point]:
    """Yield the worst inputs of the linear loop, and inputs that its second-order terms rectify."""
    omegas = np.geomspace(slowest, MAX_OMEGA, 80)
    pulses = np.diff(steps, axis=0, prepend=0.0).reshape(len(steps), -1)
    G = (np.exp(-1j * np.outer(omegas, dt * np.arange(len(steps)))) @ pulses).reshape(-1, 6, 3) * budget
    rates = np.linspace(0.0, 1.0, omegas.size)
    yield _point("held moments", (0, 0, 0), True, 0.0, np.zeros(3), np.ones(3))
    _, gains, directions = np.linalg.svd(G[:, :3])
    peak = int(np.argmax(gains[:, 0]))
    v = directions[peak, 0].conj()
    phases = np.angle(v) / (2.0 * math.pi)
    for square in (False, True):
        yield _point("largest singular value", (1, 1, 1), square, rates[peak], phases, np.abs(v) / np.max(np.abs(v)))
    for i, j, k, name in _RECTIFICATIONS:
        angle, rate = G[:, i, i], G[:, 3 + j, j]
        peak = int(np.argmax(np.abs(angle) * np.abs(rate)))
        phases = np.zeros(3)
        phases[[i, j]] = -np.angle([angle[peak], rate[peak]]) / (2.0 * math.pi)
        multiples = (int(k != 0), int(k != 1), int(k != 2))
        for square in (False, True):
            for held in (0.25, 0.75):  # moment about the third axis held, positive or negative
                phases[k] = held
                yield _point(f"rectification of {name}", multiples, square, rates[peak], phases, np.ones(3))


def _point(
    start: str, multiples: tuple[int, int, int], square: bool, rate: float, phases: Array, amplitudes: Array
) -> Point:
    x = np.full(SIZE, 0.5)
    x[RATE], x[PHASES], x[AMPLITUDES] = rate, phases % 1.0, amplitudes
    return Point(start, multiples, square, x)


def random_point(start: str, rng: np.random.Generator) -> Point:
    """Return a random point named `start`, with the whole moment budget about each axis; the search may reduce it."""
    L, M, N = rng.integers(0, 3, size=3).tolist()
    x = rng.random(SIZE)
    x[AMPLITUDES] = 1.0
    return Point(start, (L, M, N), bool(rng.integers(2)), x)


def randomize_vehicle(point: Point, rng: np.random.Generator) -> Point:
    """Return the point with a random vehicle."""
    x = point.x.copy()
    x[INERTIA], x[LAG] = rng.random(3), rng.random()
    return point._replace(x=x)
