"""Attitude references of a scenario, sample by sample."""

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.scenario import Scenario


def references(scenario: Scenario) -> NDArray[np.float64]:
    """Return the attitude reference at each sample, (samples, 3) [rad] phi, theta, psi."""
    reference = np.zeros((scenario.samples, 3))
    for time_us, euler in scenario.references:
        reference[time_us // scenario.sample_us :] = euler
    return reference
