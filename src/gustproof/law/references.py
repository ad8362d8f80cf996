"""Attitude references of a scenario, sample by sample."""

import math

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.scenario import Scenario
from gustproof.law.form import Law

RADIANS = math.pi / 180.0
"""[rad/deg] of the roll and pitch that a position loop asks for, so on every route."""


def describe_other_rate(scenario: Scenario, name: str, dt: float | None) -> str:
    """Return that the law `name` steps at another rate than a scenario; empty if at the same, or at any (`None`)."""
    if dt in (None, scenario.dt):
        return ""
    return f"law '{name}' steps every {dt} s, scenario '{scenario.name}' every {scenario.dt} s"


def describe_untracked(scenario: Scenario, law: Law) -> str:
    """Return why a law can't fly a scenario whose position loop asks for roll and pitch; empty if it can."""
    if not scenario.holds_place or law.takes_references:
        return ""
    return f"law '{law.name}' has no reference input: it can't track the position loop of '{scenario.name}'"


def references(scenario: Scenario, begin: int = 0, end: int | None = None) -> NDArray[np.float64]:
    """Return the attitude reference at each sample from `begin` to before `end`, (n, 3) [rad] phi, theta, psi."""
    reference = np.zeros(((scenario.samples if end is None else end) - begin, 3))
    for time_us, euler in scenario.references:
        reference[max(time_us // scenario.sample_us - begin, 0) :] = euler
    return reference
