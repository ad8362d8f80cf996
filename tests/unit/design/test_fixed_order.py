"""`gustproof design hinfstruct`: a law of the order asked for, that flies, and every mistake in one line."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from gustproof.airframe.hover import linear_law
from gustproof.cli.app import app
from gustproof.design.derive import derive
from gustproof.design.designs import load_design
from gustproof.design.fixed_order import solve_structured
from gustproof.errors import DesignError
from gustproof.law.form import load_law
from gustproof.robust.lti.bilinear import tustin


def solver(order: int):
    return lambda design, problem: solve_structured(
        design, problem, order=order, starts=1, seed=1, progress=lambda _fraction, _text: None
    )


@pytest.mark.slow
def test_the_command_writes_a_law_of_the_order_asked_for(tmp_path):
    path = tmp_path / "reduced.json"
    arguments = ["design", "hinfstruct", "D2", "6", "--starts", "1", "-o", str(path), "--json"]
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
    K = report.result.lti
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
        (("7",), "can't be shared out among 3 axes"),
        (("6", "--angle-rad", "0.1"), "--angle-rad and --rate-rad-s go together"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(options, words):
    done = CliRunner().invoke(app, ["design", "hinfstruct", "D2", *options])
    assert done.exit_code == 2
    assert words in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
