"""Scheduled laws: their sampling, their continuous origin, and what they are at constant parameters."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gustproof.airframe.hover import linear_law
from gustproof.law.discretize import central_law
from gustproof.law.form import Output, Provenance, load_law
from gustproof.law.resample import resample
from gustproof.law.schedule import continuous_controller, corners, law_at
from gustproof.robust.lti.state_space import Lti
from gustproof.robust.uncertain.uncertain_system import Uncertain
from gustproof.robust.uncertain.uncertainty import FullBlock, RealBlock

BLOCKS = (
    RealBlock(name="v", low=-0.2, high=0.2, nominal=0.0, repeats=2),
    RealBlock(name="q", low=-0.5, high=0.5, nominal=0.0),
    RealBlock(name="t", low=-0.3, high=0.3, nominal=0.0),
)
OMEGA = np.geomspace(0.1, 300.0, 9)


def controller(blocks=BLOCKS) -> Uncertain:
    rng = np.random.default_rng(4)
    A = np.diag([-1.0, -2.0, -3.0, -50.0, -60.0, -70.0, -9.0]) + 0.3 * rng.normal(size=(7, 7))
    B, C, D = rng.normal(size=(7, 7)), rng.normal(size=(7, 7)), 0.1 * rng.normal(size=(7, 7))
    return Uncertain(M=Lti(A=A, B=B, C=C, D=D), blocks=blocks)


def sampled(K, dt=0.004):
    return central_law(
        "turned", K, scheduled=False, dt=dt, limits=np.ones(3), output=Output.TORQUE,
        provenance=Provenance(design="", vehicle=""), rate_limits=np.full(3, 2.0),
    )  # fmt: skip


def test_at_constant_parameters_the_law_is_the_sampled_controller_of_these():
    K = controller()
    law = sampled(K)
    assert law.schedule is not None
    assert law.schedule.parameters == ("theta", "theta", "q", "phi")
    values = {"theta": 0.1, "q": -0.4, "phi": 0.5}
    delta = {"v": math.tan(0.05) / 0.2, "q": -0.8, "t": math.tan(0.25) / 0.3}
    expected = linear_law(sampled(K.member(delta))).response(OMEGA)
    np.testing.assert_allclose(linear_law(law_at(law, values)).response(OMEGA), expected, rtol=1e-9)
    level = linear_law(sampled(K.nominal_system())).response(OMEGA)
    np.testing.assert_allclose(linear_law(law).response(OMEGA), level, rtol=1e-12)
    np.testing.assert_array_equal(law_at(law, {"q": 9.0}).A, law_at(law, {"q": 0.5}).A)
    linear = load_law("hinf-d1")
    assert law_at(linear, values) is linear


def test_the_continuous_controller_comes_back_out_of_the_law():
    K = controller()
    back = continuous_controller(sampled(K))
    assert [(block.name, block.high, block.repeats) for block in back.blocks] == [
        ("t", pytest.approx(0.3), 1), ("q", 0.5, 1), ("v", pytest.approx(0.2), 2),
    ]  # fmt: skip
    for delta in ({block.name: share for block in K.blocks} for share in (-0.4, 0.0, 0.7)):
        own, other = (each.member(delta).response(OMEGA) for each in (K, back))
        np.testing.assert_allclose(other, own, rtol=1e-8)


def test_a_scheduled_law_at_another_rate_is_the_one_made_at_it():
    K = controller()
    moved, made = resample(sampled(K), 400.0).schedule, sampled(K, 0.0025).schedule
    for part in ("limits", "J", "K", "L", "P", "Q"):
        np.testing.assert_allclose(getattr(moved, part), getattr(made, part), rtol=1e-9, atol=1e-12)


def test_every_corner_of_the_box_counts_once():
    found = list(corners(sampled(controller()).schedule))
    assert len(found) == 8
    assert {round(corner["theta"], 6) for corner in found} == {0.394791, -0.394791}


@pytest.mark.parametrize(
    ("block", "words"),
    [
        (RealBlock(name="lag", low=-1.0, high=1.0, nominal=0.0, repeats=4), "the real parameters t, v, p, q, r alone"),
        (FullBlock(name="q", n_outputs=4, n_inputs=4), "the real parameters t, v, p, q, r alone"),
        (RealBlock(name="q", low=-1.0, high=2.0, nominal=0.0, repeats=4), "must be symmetric about 0"),
    ],
)
def test_parameters_that_are_none_of_a_schedule_are_refused(block, words):
    with pytest.raises(ValueError, match=words):
        sampled(controller((block,)))


def test_a_law_without_schedule_or_with_more_has_no_scheduled_controller(turn):
    with pytest.raises(ValueError, match="has no schedule"):
        continuous_controller(load_law("hinf-d1"))
    with pytest.raises(ValueError, match="more than a schedule"):
        continuous_controller(turn(load_law("hinf-scheduled")))
    unsampled = turn(load_law("hinf-d1"))
    with pytest.raises(ValueError, match="more than a schedule"):
        continuous_controller(replace(unsampled, B=np.ones_like(unsampled.B)))
