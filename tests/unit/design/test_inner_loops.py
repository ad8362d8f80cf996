import math
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.files import write_toml
from firmware_model.errors import ConfigError
from gustproof.airframe.hover import loop_law
from gustproof.design.designs import load_design
from gustproof.design.inner_loops import InnerLoop, InnerLoops, fit_inner_loop, load_inner_loops
from gustproof.design.rate_law import derive_over
from gustproof.errors import DesignError
from gustproof.flight.endpoint.excitation import DT, OMEGA
from gustproof.robust.lti.margins import margins
from gustproof.robust.lti.state_space import Lti, delay, discretize_zoh, series

STOCK = InnerLoops(
    name="stock",
    roll=InnerLoop(omega=9.0, damping=0.7, delay=0.01),
    pitch=InnerLoop(omega=8.0, damping=0.7, delay=0.01),
    yaw=InnerLoop(omega=3.0, damping=0.9, delay=0.03),
)

# Yaw of ArduPilot's stock gains on vehicle `paper`, measured in flight.
RESONANT = np.array([0.97, 1.16, 1.27, 1.99, 8.67, 0.64, 0.18, 0.05]) * np.exp(
    1j * np.radians([1, -1, -12, -21, -121, -219, -250, -294])
)


def response(loop: InnerLoop, omega: np.ndarray, late: float = 0.0) -> np.ndarray:
    s = 1j * omega
    lag = np.exp(-(loop.delay + late) * s)
    return loop.omega**2 * lag / (s**2 + 2.0 * loop.damping * loop.omega * s + loop.omega**2)


@pytest.mark.parametrize("axis", ["roll", "pitch", "yaw"])
def test_fit_finds_the_loop_and_takes_hold_and_delay_of_sampling_off(axis):
    loop = getattr(STOCK, axis)
    found = fit_inner_loop(OMEGA, response(loop, OMEGA, 1.5 * DT), DT, "yaw")
    assert (found.omega, found.damping, found.delay) == pytest.approx((loop.omega, loop.damping, loop.delay), rel=1e-3)
    assert found.misfit < 1e-3


def test_noise_is_no_rate_loop():
    rng = np.random.default_rng(1)
    with pytest.raises(DesignError, match="response in yaw is not that of a rate loop"):
        fit_inner_loop(OMEGA, rng.normal(size=8) + 1j * rng.normal(size=8), DT, "yaw")


def test_resonant_loop_is_found_and_followed_slowly():
    loop = fit_inner_loop(OMEGA, RESONANT, DT, "yaw")
    assert (loop.omega, loop.damping, loop.peak) == pytest.approx((8.11, 0.057, 8.8), rel=0.01)
    assert loop.misfit < 0.4
    # an open loop that crosses 1 there and falls as 1/s is a quarter at the peak
    slow = InnerLoops(name="slow", roll=STOCK.roll, pitch=STOCK.pitch, yaw=loop).fastest()
    assert slow[2] == pytest.approx(0.25 * 8.11 / 8.8, rel=0.01)
    assert np.all(slow[:2] == STOCK.fastest()[:2])
    assert STOCK.yaw.peak == 1.0


def test_loop_about_to_oscillate_is_told_by_its_peak():
    with pytest.raises(DesignError, match=r"yaw answers 8\.7 times its command at 8\.2 rad/s: .* oscillate"):
        fit_inner_loop(OMEGA, RESONANT.conj(), DT, "yaw")


def test_delay_in_the_loop_agrees_to_second_order():
    omega, damping = STOCK.yaw.without_delay()
    for slow in (0.05, 0.1, 0.2):
        exact = response(STOCK.yaw, np.array([slow]))[0]
        folded = response(InnerLoop(omega=omega, damping=damping), np.array([slow]))[0]
        assert abs(folded - exact) < 0.1 * slow**3


def test_file_is_read_back_equal_and_a_wrong_key_is_named(tmp_path):
    path = tmp_path / "stock.toml"
    write_toml(STOCK, path)
    assert load_inner_loops(path) == STOCK
    path.write_text(path.read_text(encoding="utf-8").replace("damping", "dumping", 1), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"roll\.d[au]mping"):
        load_inner_loops(path)


@pytest.mark.slow
@pytest.mark.parametrize(
    "yaw", [STOCK.yaw, InnerLoop(omega=8.11, damping=0.057, delay=0.045)], ids=["slow", "resonant"]
)
def test_law_is_no_faster_than_each_loop_and_stable_on_the_exact_one(yaw):
    loops = replace(STOCK, yaw=yaw)
    law, report = derive_over(load_design("R1"), loops)
    assert (law.name, report.design.name) == ("hinf-rates-stock", "R1-stock")
    crossovers = [loop.crossover for loop in report.sampled.input[:3]]
    assert np.all(np.array(crossovers) < 1.05 * loops.fastest())
    assert crossovers[2] < 0.5 * crossovers[0]
    # the loops themselves, on the axes' integrators, their delay as whole samples
    A, B = np.zeros((9, 9)), np.zeros((9, 3))
    A[:3, 3:6], A[3:6, 6:] = np.eye(3), np.eye(3)
    A[:3, :3] = -1e-3 * np.eye(3)
    for k, loop in enumerate((loops.roll, loops.pitch, yaw)):
        A[6 + k, 3 + k], A[6 + k, 6 + k] = -(loop.omega**2), -2.0 * loop.damping * loop.omega
        B[6 + k, k] = loop.omega**2
    plant = discretize_zoh(Lti(A=A, B=B, C=np.eye(3, 9, 3), D=np.zeros((3, 3))), law.dt)
    worst, last = [], 1 + math.ceil(yaw.delay / law.dt)
    for late in range(1, last + 1):
        plant = series(delay(3, law.dt), plant)
        if late in (4, last):
            Ms = [loop.Ms for loop in margins(plant, loop_law(law)).input[:3]]
            worst += Ms[:2] if late == 4 else Ms[2:]
    assert len(worst) == 3
    assert max(worst) < 1.7


def test_design_that_commands_torque_is_refused():
    with pytest.raises(DesignError, match="commands torque"):
        derive_over(load_design("D1"), STOCK)
