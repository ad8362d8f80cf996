"""What keeps an autopilot from holding the vehicle still, by the vehicle's motion."""

import numpy as np
import pytest

from firmware_model.external.flight import describe_unrest


def swing(frequency: float, size: float, offset: float = 0.0, axis: int = 0) -> np.ndarray:
    omega_B = 0.001 * np.ones((750, 3))
    omega_B[:, axis] = offset + size * np.sin(2.0 * np.pi * frequency * 0.004 * np.arange(750))
    return omega_B


@pytest.mark.parametrize(
    ("omega_B", "height", "said"),
    [
        (swing(0.0, 0.0, 5.4, axis=2), 0.0, "turns one way about yaw at 5.40 rad/s: its rotors' geometry"),
        (swing(4.0, 0.3, -1.0, axis=2), 0.0, "turns one way about yaw at -1.00 rad/s: its rotors' geometry"),
        (swing(4.0, 0.3), 0.0, "swings about roll at 4.0 Hz, by up to 0.30 rad/s: its gains are too high"),
        (swing(11.0, 2.0, 0.2, axis=1), 0.0, "swings about pitch at 11.0 Hz, by up to 2.20 rad/s: its gains"),
        (swing(1.0, 0.01), -1.25, "is off its height by -1.2 m: its hover thrust"),
    ],
)
def test_vehicle_that_does_not_come_to_rest_is_told_with_a_cause(omega_B, height, said):
    assert describe_unrest(omega_B, 0.004, height).startswith(said)
