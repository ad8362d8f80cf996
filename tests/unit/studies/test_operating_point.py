"""The operating point of a controller, measured by flights, is that of its linear analysis."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.airframe.hover import hover_plant, loop_law
from gustproof.errors import DesignError
from gustproof.law.form import load_law
from gustproof.robust.lti.margins import loop_margins, margins
from gustproof.robust.lti.state_space import gain, lft, series
from gustproof.studies import operating_point
from gustproof.studies.operating_point import measure_operating_point

AIR, PAPER = load_scenario("paper-turbulence"), load_vehicle("paper")
FIGURES = ("Ms", "gain_margin", "gain_reduction_margin", "delay_margin", "phase_margin", "crossover")


@pytest.mark.parametrize("name", ["pid-fair", "aided"])
def test_the_operating_point_of_a_law_is_that_of_its_analysis(name: str) -> None:
    law = load_law(name)
    found = measure_operating_point(law, PAPER, AIR, seeds=())
    expected = margins(hover_plant(PAPER, AIR, with_attitude=law.uses_accelerometer), loop_law(law)).input
    for axis, known in zip(found.axes, expected, strict=True):
        for figure in FIGURES:
            assert getattr(axis, figure) == pytest.approx(getattr(known, figure), rel=1e-3), figure
    assert found.distortion < 1e-3
    assert found.slew is None


def test_a_pilot_that_is_not_linear_is_told() -> None:
    weak = replace(load_law("pid-fair"), limits=np.array([0.5, 10.0, 10.0]))  # below the torque of the experiment
    assert measure_operating_point(weak, PAPER, AIR, seeds=()).distortion > 0.02


def test_an_unstable_loop_has_no_operating_point() -> None:
    law = load_law("pid-fair")
    with pytest.raises(
        DesignError, match="'pid-fair' has no operating point on 'paper': in calm air the loop does not settle"
    ):
        measure_operating_point(replace(law, C=-law.C, D=-law.D), PAPER, AIR, seeds=())


@pytest.mark.parametrize("name", ["flagship", "flagship-robust", "indi", "hinf-d2"])
def test_margins_between_the_sines_are_interpolated(name: str) -> None:
    law = load_law(name)
    L = -series(hover_plant(PAPER, AIR), loop_law(law))
    omega = 2.0 * np.pi / operating_point.PERIOD_S * operating_point._choose_lines(AIR)
    one = lft(L.subsystem([1, 0, 2], [1, 0, 2]), gain(-np.eye(2), AIR.dt))
    found = operating_point._margins(omega, operating_point._close_others(L.response(omega), 1))
    expected = loop_margins(one)
    for figure in FIGURES:
        assert getattr(found, figure) == pytest.approx(getattr(expected, figure), rel=1e-3), figure
