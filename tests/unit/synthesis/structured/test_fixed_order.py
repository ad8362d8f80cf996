"""`gustproof design --method hinfstruct`: a law of the order asked for, that flies, and every mistake in one line."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from gustproof.cli.app import app
from gustproof.errors import DesignError
from gustproof.law.form import load_law
from gustproof.law.hover import linear_law
from gustproof.lti.bilinear import tustin
from gustproof.synthesis.derive import derive
from gustproof.synthesis.designs import load_design
from gustproof.synthesis.structured.fixed_order import solve_structured


def solver(order: int):
    return lambda design, problem: solve_structured(
        design, problem, order=order, starts=1, seed=1, progress=lambda _fraction, _text: None
    )


@pytest.mark.slow
def test_the_command_writes_a_law_of_the_order_asked_for(tmp_path):
    path = tmp_path / "reduced.json"
    arguments = ["design", "D2", "--method", "hinfstruct", "--order", "6", "--starts", "1", "-o", str(path), "--json"]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["order"] == load_law(path).order == 6
    assert told["gamma_opt"] <= told["norm"] <= 1.05 * told["gamma_opt"]
    assert path.with_suffix(".png").exists()


@pytest.mark.slow
def test_a_self_scheduled_law_keeps_attitudes_and_rates_first_and_the_linear_law_is_the_controller():
    design = replace(load_design("D2"), scheduled=True)
    law, report = derive(design, solve=solver(6))
    K = report.result.controller
    assert law.is_scheduled
    assert np.array_equal(K.A[:3, 3:6], np.eye(3))
    assert np.array_equal(K.A[:3, :3], -design.leak * np.eye(3))
    sampled = tustin(K, design.dt)
    omega = np.geomspace(0.01, 100.0, 7)
    assert np.allclose(linear_law(law).response(omega), sampled.response(omega), rtol=1e-6, atol=1e-9)


def test_one_state_an_axis_makes_a_law_too():
    law, report = derive(load_design("D1"), solve=solver(3))
    assert law.order == 3
    assert report.result.gamma == pytest.approx(0.2521, abs=2e-4)


def test_a_self_scheduled_law_needs_an_attitude_and_a_rate():
    with pytest.raises(DesignError, match="needs an order of 6 or more"):
        derive(replace(load_design("D2"), scheduled=True), solve=solver(3))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--method", "hinfstruct"), "needs --order"),
        (("--order", "6"), "--order cannot be given with it"),
        (("--method", "hinfstruct", "--order", "7"), "can't be shared out among 3 axes"),
        (("--method", "hinfstruct", "--order", "6", "--gamma", "0.3"), "--gamma cannot be given with it"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(options, words):
    done = CliRunner().invoke(app, ["design", "D2", *options])
    assert done.exit_code == 2
    assert words in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
