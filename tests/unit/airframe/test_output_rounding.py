"""The slew of rounded rotor commands, against rounded commands."""

import numpy as np
import pytest

from firmware_model.config.vehicle import load_vehicle
from gustproof.airframe.output_rounding import rounding_slew

ROTORS = load_vehicle("paper").rotors
STEP, DT = 0.05, 0.0025


@pytest.mark.parametrize("slew", [(0.05, 0.05, 0.05), (0.5, 0.5, 0.1), (5.0, 3.0, 1.0), (50.0, 50.0, 50.0)])
def test_it_is_that_of_rounded_commands(slew: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(1)
    torques = np.cumsum(DT * np.array(slew) * rng.normal(size=(200_000, 3)), axis=0)
    thrusts = torques @ np.linalg.inv(ROTORS.wrench)[:, :3].T + rng.uniform(size=4)
    rounded = STEP * np.round(thrusts / STEP)
    added = np.diff((rounded - thrusts) @ ROTORS.wrench[:3].T, axis=0) / DT
    assert rounding_slew(slew, ROTORS, STEP, DT) == pytest.approx(np.sqrt(np.mean(added**2)), rel=0.03)


def test_commands_that_are_not_rounded_add_none() -> None:
    assert rounding_slew((5.0, 5.0, 5.0), ROTORS, 0.0, DT) == 0.0
