"""Attitude references of a scenario, sample by sample."""

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.scenario import Scenario


def references(scenario: Scenario, begin: int = 0, end: int | None = None) -> NDArray[np.float64]:
    """Return the attitude reference at each sample from `begin` to before `end`, (n, 3) [rad] phi, theta, psi."""
    reference = np.zeros(((scenario.samples if end is None else end) - begin, 3))
    for time_us, euler in scenario.references:
        reference[max(time_us // scenario.sample_us - begin, 0) :] = euler
    return reference
