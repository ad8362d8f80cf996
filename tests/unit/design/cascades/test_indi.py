"""INDI in the law form: it is the textbook's block diagram, and it does not wind up."""

import math

import numpy as np
import pytest

from firmware_model.config.vehicle import load_vehicle
from gustproof.design.cascades.indi import IndiGains, indi_axis
from gustproof.law.cascade import cascade_law
from gustproof.law.form import Provenance
from gustproof.law.step import step

GAINS = IndiGains(angle_p=4.0, rate_p=12.0, cutoff=20.0, damping=0.5)
INERTIA, LAG, DT = 0.25, 0.05, 0.004


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_the_law_is_the_block_diagram(delay: int) -> None:
    z = np.exp(1j * np.geomspace(0.1, 700.0, 50) * DT)
    s = 2.0 / DT * (z - 1.0) / (z + 1.0)
    corner = 2.0 * math.pi * GAINS.cutoff
    H = corner**2 / (s**2 + 2.0 * GAINS.damping * corner * s + corner**2)
    keep = math.exp(-DT / LAG)
    actuator = (1.0 - keep) / (z - keep) * z**-delay
    wanted = -GAINS.rate_p * (1.0 + GAINS.angle_p / s)
    expected = INERTIA * (wanted - s * H) / (1.0 - H * actuator)
    law = indi_axis(GAINS, INERTIA, LAG, delay, DT).controller(DT)
    response = law.response(np.angle(z) / DT)[:, 0, 0]
    np.testing.assert_allclose(response, expected, rtol=1e-9)


@pytest.mark.parametrize("delay", [0, 1, 2])
def test_the_reference_is_followed_without_offset(delay: int) -> None:
    law = indi_axis(GAINS, INERTIA, LAG, delay, DT)
    states = np.linalg.lstsq(np.eye(law.A.shape[0]) - law.A_linear, law.B[:, 1], rcond=None)[0]
    # At rest under a reference, the attitude is the reference and there is no torque.
    states[0] = 1.0
    np.testing.assert_allclose(law.A_linear @ states + law.B[:, 1], states, atol=1e-12)
    np.testing.assert_allclose(law.C @ states + law.D[:, 1], 0.0, atol=1e-12)


@pytest.mark.parametrize("delay", [0, 1, 2])
def test_the_torque_it_reckons_with_is_that_of_an_actuator_at_its_limit(delay: int) -> None:
    vehicle = load_vehicle("paper")
    axes = [indi_axis(GAINS, inertia, LAG, delay, DT) for inertia in vehicle.inertia_B]
    law = cascade_law("test", axes, vehicle, DT, Provenance(design="test", vehicle="paper"))
    x, torque, sent = np.zeros(law.order), np.zeros(3), [np.zeros(3)] * delay
    keep = math.exp(-DT / LAG)
    rng = np.random.default_rng(1)
    at_limit = 0
    for _ in range(300):
        np.testing.assert_allclose(x[18:21], torque, atol=1e-9)
        x, command = step(law, x, np.concatenate([rng.normal(size=3), np.zeros(3)]))
        at_limit += int(np.any(np.abs(command) == law.limits))
        sent.append(command)
        torque = keep * torque + (1.0 - keep) * sent.pop(0)
    assert at_limit > 100


@pytest.mark.parametrize("name", ["angle_p", "rate_p", "cutoff", "damping"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.inf, math.nan])
def test_gains_that_are_not_positive_are_refused(name: str, value: float) -> None:
    gains = {"angle_p": 4.0, "rate_p": 12.0, "cutoff": 20.0, "damping": 0.5, name: value}
    with pytest.raises(ValueError, match=f"{name} is {value!r}, must be positive"):
        IndiGains(**gains)
