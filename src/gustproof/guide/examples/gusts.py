# SPDX-License-Identifier: BSD-3-Clause
# Copyright (c) 2026, the gustproof maintainers
"""Ten thousand vehicles in turbulence at once: `python gusts.py numpy`, or `jax`, or `torch`.

Each has a wind of its own. It holds its attitude by proportional and derivative gains against the moment of the gusts.
For another simulator copy `firmware_model/physics/gust_filters.py` beside it and take the two calls of `step_all`.
"""

import math
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from firmware_model.physics.gust_filters import (
    DrydenParams,
    DrydenState,
    TransverseParams,
    dryden_gust,
    dryden_step,
    low_altitude_spectrum,
    make_filters,
    stationary_state,
)

GAINS = 60.0, 11.0
"""[1/s^2], [1/s] angular acceleration per angle and per rate."""
DAMPING = 0.8
"""[1/s] of the rotors, per rate relative to the air."""


class Fleet(NamedTuple):
    """Roll and pitch of all vehicles, and their air."""

    angle: tuple[Any, Any]
    """(n,) [rad] each."""
    rate: tuple[Any, Any]
    """(n,) [rad/s] each."""
    air: DrydenState
    """(n,) each number, units beside each."""


def stack(each: Sequence[Any], array: Callable[[Any], Any]) -> Any:
    """Return filters or states, one an environment, as one whose numbers are arrays (n,)."""
    first = each[0]
    if isinstance(first, DrydenParams | TransverseParams | DrydenState):
        return type(first)._make(stack(column, array) for column in zip(*each, strict=True))
    return array(each)


def step_all(filters: DrydenParams, fleet: Fleet, n: Any, gain: float, dt: float) -> Fleet:
    """Return all vehicles a step `dt` [s] later, for standard normal `n` (8, n) and a `gain` [rad/s^2/(m/s)]."""
    (u, v, _), (p, q, _) = dryden_gust(filters, fleet.air)
    angles, rates = [], []
    for angle, rate, gust, air_rate in zip(fleet.angle, fleet.rate, (gain * v, -gain * u), (p, q), strict=True):
        rates.append(rate + dt * (gust - GAINS[0] * angle - GAINS[1] * rate - DAMPING * (rate - air_rate)))
        angles.append(angle + dt * rates[-1])
    return Fleet(tuple(angles), tuple(rates), dryden_step(filters, fleet.air, n))


def start_fleet(winds: Sequence[float], n: Any, dt: float, array: Callable[[Any], Any]) -> tuple[DrydenParams, Fleet]:
    """Return the filters and the start of vehicles, each in its mean wind [m/s], for standard normal `n` (8, n)."""
    span, made = 0.5, {}
    for wind in set(winds):  # the same wind has the same filters: 1 ms each
        made[wind] = make_filters(low_altitude_spectrum(wind, altitude=10.0, span=span), span, dt)
    airs = [stationary_state(made[wind][1], column) for wind, column in zip(winds, np.transpose(n), strict=True)]
    still = array(np.zeros(len(winds)))
    filters = stack([made[wind][0] for wind in winds], array)
    return filters, Fleet((still, still), (still, still), stack(airs, array))


def main(kind: str = "numpy", count: int = 10_000, steps: int = 2500, dt: float = 0.004, gain: float = 0.9) -> float:
    """Fly `count` vehicles with numpy, jax or torch, write and return their rms tilt [deg] at the end."""
    random = np.random.default_rng(1)
    winds = random.choice(np.linspace(2.0, 15.0, 50), count).tolist()
    n = random.standard_normal((8, count))
    if kind == "jax":
        jax = import_module("jax")
        filters, fleet = start_fleet(winds, n, dt, jax.numpy.asarray)

        def step(fleet: Fleet, key: Any) -> tuple[Fleet, None]:
            return step_all(filters, fleet, jax.random.normal(key, (8, count)), gain, dt), None

        fly = jax.jit(lambda fleet, keys: jax.lax.scan(step, fleet, keys)[0])
        fleet = fly(fleet, jax.random.split(jax.random.key(1), steps))
    else:
        torch = import_module("torch") if kind == "torch" else None
        filters, fleet = start_fleet(winds, n, dt, torch.as_tensor if torch else np.asarray)
        for _ in range(steps):
            n = torch.randn(8, count, dtype=torch.float64) if torch else random.standard_normal((8, count))
            fleet = step_all(filters, fleet, n, gain, dt)
    tilt = math.degrees(math.sqrt(sum(float((angle * angle).mean()) for angle in fleet.angle)))
    sys.stdout.write(f"{count} vehicles, {steps * dt:g} s each, in {kind}: tilt {tilt:.3f} deg rms at the end\n")
    return tilt


if __name__ == "__main__":
    main(sys.argv[1] if sys.argv[1:] else "numpy")
