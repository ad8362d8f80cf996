"""Laws of the literature are what their sources say."""

import math
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.airframe.covariance import AxisModel, augmented_axis, axis_models, open_loop
from gustproof.airframe.limits import kalman_gain
from gustproof.design.literature.adrc import AdrcGains, build_adrc
from gustproof.design.literature.dob import DobGains, build_dob
from gustproof.design.literature.l1 import L1Gains, build_l1
from gustproof.design.literature.loop_shaping import (
    LoopShapingGains,
    build_loop_shaping,
    shaped_plant,
)
from gustproof.design.literature.lqg import LqgGains, build_lqg, filter_gain, regulator_gain, strapdown_flight
from gustproof.law.cascade import AxisLaw
from gustproof.robust.coprime.ncfsyn import ncfsyn
from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import Lti, gain, lft, sensitivity

AIR, PAPER = load_scenario("paper-turbulence"), load_vehicle("paper")
LAG, DT = PAPER.actuator_lag, AIR.dt
Z = np.exp(1j * np.geomspace(0.1, 700.0, 50) * DT)
S = 2.0 / DT * (Z - 1.0) / (Z + 1.0)
LQG = LqgGains(effort=0.005, gust=2.0, recovery=3.0)
SHAPING = LoopShapingGains(angle_p=4.0, gain=14.0, rate_i=8.0, cutoff=180.0)
ADRC = AdrcGains(angle_p=3.5, rate_p=45.0, observer=30.0, inertia_ratio=0.6)
L1 = L1Gains(angle_p=4.0, rate_p=10.0, cutoff=60.0)
DOB = DobGains(angle_p=4.0, rate_p=9.0, cutoff=35.0, damping=1.1)
LAWS = [(build_lqg, LQG), (build_loop_shaping, SHAPING), (build_adrc, ADRC), (build_l1, L1), (build_dob, DOB)]


def roll(delay: int = 1) -> AxisModel:
    return axis_models(PAPER, replace(AIR, delay_samples=delay))[0]


def law_of(build, gains, model: AxisModel) -> AxisLaw:
    signals = build(gains, model)
    return signals.axis_law(signals.loop.order, None)


@pytest.mark.parametrize("delay", [0, 1, 3])
@pytest.mark.parametrize(("build", "gains"), LAWS)
def test_the_reference_is_followed_without_offset(build, gains, delay: int) -> None:
    law = law_of(build, gains, roll(delay))
    states = np.eye(law.A.shape[0])[0]  # at rest the attitude is the reference, and all else is 0
    np.testing.assert_allclose(law.A_linear @ states + law.B[:, 1], states, atol=1e-9)
    np.testing.assert_allclose(law.C @ states + law.D[:, 1], 0.0, atol=1e-9)


@pytest.mark.parametrize(("build", "gains"), LAWS)
def test_the_loop_is_stable(build, gains) -> None:
    assert sensitivity(open_loop(roll(), law_of(build, gains, roll()).controller(DT))).is_stable()


def frozen_poles(law: AxisLaw) -> np.ndarray:
    """Return the poles of the states behind strapdown while the command stays at its limit."""
    return np.linalg.eigvals((law.A - law.H @ law.C)[2:, 2:])


def test_the_poles_of_the_extended_state_observer_are_at_its_bandwidth() -> None:
    poles = frozen_poles(law_of(build_adrc, ADRC, roll()))
    # a triple pole: its eigenvalues carry the cube root of rounding, their mean and product do not
    pole = math.exp(-ADRC.observer * DT)
    assert np.prod(poles).real == pytest.approx(pole**3, rel=1e-9)
    assert np.mean(poles).real == pytest.approx(pole, rel=1e-9)
    np.testing.assert_allclose(poles, pole, atol=1e-4)


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_l1_is_its_block_diagram(delay: int) -> None:
    J, keep = PAPER.inertia_B[0], math.exp(-DT / LAG)
    actuator = (1.0 - keep) / (Z - keep) * Z**-delay
    decay = math.exp(-L1.rate_p * DT)
    held = (1.0 - decay) / L1.rate_p
    share = 1.0 - math.exp(-L1.cutoff * DT)
    low_pass = share * Z / (Z - 1.0 + share)
    # the predictor's error is 0 before each sample but for what the moment adds: sigma = J decay / held (rate - x)
    by_rate, by_torque = J * decay / held * (1.0 - 1.0 / Z), -decay / Z * actuator
    expected = (-J * L1.rate_p * (1.0 + L1.angle_p / S) - low_pass * by_rate) / (1.0 + low_pass * by_torque)
    response = law_of(build_l1, L1, roll(delay)).controller(DT).response(np.angle(Z) / DT)[:, 0, 0]
    np.testing.assert_allclose(response, expected, rtol=1e-8)


@pytest.mark.parametrize("delay", [1, 3])
def test_the_disturbance_observer_is_its_block_diagram(delay: int) -> None:
    J = PAPER.inertia_B[0]
    Q = DOB.cutoff**2 / (S**2 + 2.0 * DOB.damping * DOB.cutoff * S + DOB.cutoff**2)
    expected = -J * DOB.rate_p * (1.0 + DOB.angle_p / S) - Q * J * S * (LAG * S + 1.0)
    response = law_of(build_dob, DOB, roll(delay)).controller(DT).response(np.angle(Z) / DT)[:, 0, 0]
    np.testing.assert_allclose(response, expected / (1.0 - Q * Z**-delay), rtol=1e-8)


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_poles_of_lqg_are_those_of_regulator_and_filter(delay: int) -> None:
    model = roll(delay)
    known = strapdown_flight(model)
    F, K = regulator_gain(LQG, model), filter_gain(LQG, model)
    regulator = np.linalg.eigvals(known.A - known.B[:, -1:] @ F)
    A, C = known.A[1:, 1:], known.C[2:, 1:]
    estimator = np.linalg.eigvals(A @ (np.eye(len(A)) - K @ C))
    closed = lft(augmented_axis(model), law_of(build_lqg, LQG, model).controller(DT))
    # the attitude of the vehicle itself is an integral beside that of the law; last_rate is a pole at 0
    expected = np.sort_complex(np.concatenate([regulator, estimator, [0.0, 1.0]]))
    points = np.exp(2j * np.pi * np.arange(12) / 12.0) * 1.5
    found, wanted = (np.prod(points[:, None] - poles, axis=1) for poles in (closed.poles(), expected))
    np.testing.assert_allclose(found, wanted, rtol=1e-9)


def test_the_filter_of_lqg_is_the_optimal_one_without_fictitious_noise() -> None:
    gains = replace(LQG, gust=1.0, recovery=1e-9)
    np.testing.assert_allclose(
        filter_gain(gains, roll()), kalman_gain(augmented_axis(roll()))[1:], rtol=1e-6, atol=1e-12
    )


def test_loop_shaping_withstands_the_uncertainty_of_its_gamma() -> None:
    plant = shaped_plant(SHAPING, roll())
    result = ncfsyn(plant)
    K, gamma = result.lti, result.gamma
    # [K; I] (I - G K)^-1 [I, G], as an interconnection with inputs (w1, w2) and outputs (u, y), y = w1 + G (w2 + u)
    G = plant
    B = np.hstack([np.zeros((G.order, 1)), G.B, G.B])
    C = np.vstack([np.zeros((1, G.order)), G.C, G.C])
    D = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    closed = lft(Lti(A=G.A, B=B, C=C, D=D, dt=DT), K)
    assert closed.is_stable()
    norm = hinf_norm(closed).gain
    assert gamma / 1.1 * (1.0 - 1e-6) <= norm <= gamma * (1.0 + 1e-6)


def test_least_gamma_of_a_pure_gain_is_known() -> None:
    # an integrator: X = Z = 1, so that the least gamma is the square root of 2
    assert ncfsyn(Lti(A=[[0.0]], B=[[1.0]], C=[[1.0]], D=gain(0.0).D)).gamma == pytest.approx(1.1 * math.sqrt(2.0))
