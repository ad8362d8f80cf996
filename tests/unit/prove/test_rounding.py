"""Single precision: the bound of an hour's flight, and each row's rounding against doubles."""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from firmware_model.config.files import read_text
from firmware_model.config.vehicle import vehicle_path
from gustproof.checker import single_precision
from gustproof.checker.flight_box import make_case, read_claim
from gustproof.checker.kernel_norms import X0, axis_norms
from gustproof.checker.single_precision import Form, bound_rounding
from gustproof.checker.system import Refusal, read_system
from gustproof.law.form import law_path, load_law
from gustproof.law.resample import resample
from gustproof.law.step import step
from gustproof.law.write.c import resting_states
from gustproof.law.write.single import SingleLaw
from gustproof.prove.boundedness import certify_boundedness
from gustproof.prove.rounding import certify_rounding

ASKED_DEG = 0.02


@pytest.mark.parametrize("name", ["flagship", "flagship-robust", "pid-fair", "indi"])
def test_an_hour_in_single_precision_adds_less_than_asked(name):
    bound = certify_rounding(load_law(name), "paper")
    assert bound.attitude_deg < ASKED_DEG
    assert max(bound.own_deg) < bound.attitude_deg
    assert f"{bound.attitude_deg:g} deg in 3600 s" in bound.describe()


def test_so_it_does_at_400_hz():
    assert certify_rounding(resample(load_law("flagship"), 400.0), "paper").attitude_deg < ASKED_DEG


def test_a_law_that_is_no_strapdown_has_a_bound_of_its_own_attitude_alone():
    bound = certify_rounding(load_law("hinf-scheduled"), "paper")
    assert bound.attitude_deg is None
    assert max(bound.own_deg) < 1e-3
    assert "true one" not in bound.describe()


def test_a_law_without_a_proven_box_has_no_bound():
    law = load_law("flagship")
    with pytest.raises(ValueError, match="unstable"):
        certify_rounding(replace(law, C=-law.C, D=-law.D), "paper")


def test_differences_by_rounding_that_grow_without_end_are_refused(monkeypatch):
    one = [[Fraction(1)]]
    monkeypatch.setattr(single_precision, "_map", lambda _system, _norms, _box, before, *_: [[1 + 2 * before[0][0]]])
    with pytest.raises(Refusal, match="the differences by rounding do not settle"):
        single_precision._fixed_point(None, [], one, [], None)


def parts(name):
    """Return all that the bound of a law takes."""
    law = load_law(name)
    certificate = certify_boundedness(name, "paper", moment=(0.65, 0.65, 0.3), horizon=None)
    claim = read_claim(certificate.evidence)
    system = read_system(read_text(law_path(name)), read_text(vehicle_path("paper")))
    norms = [axis_norms(system, axis, claim.samples) for axis in range(3)]
    resting = [Fraction(value) for value in np.abs(resting_states(law)[:, 2]).tolist()]
    form = Form(frozenset(SingleLaw(law).wide), Fraction(math.pi), resting)
    reference = [[Fraction(value) for value in row] for part in (law.B, law.D) for row in part[:, 3:6].tolist()]
    return law, system, norms, make_case(system, claim), claim.box, form, reference


@pytest.mark.slow
@pytest.mark.parametrize("name", ["flagship", "pid-fair", "hinf-scheduled"])
def test_no_sum_of_a_step_is_rounded_by_more_than_the_proof_says(name):
    law, system, _, case, box, form, reference = parts(name)
    law = replace(law, limits=np.full(3, 1e6), rate_limit=None)  # within the box no limit acts, at its corners it would
    n, single, rng, resting = law.order, SingleLaw(law), np.random.default_rng(1), resting_states(law)
    row_error = single_precision._row_error
    bounds = np.array([float(row_error(system, case, box, form, reference, i)) for i in range(n + 3)])
    sizes = np.array([float(box[j % 3][X0 + j // 3]) for j in range(n)])
    worst = np.zeros(n + 3)
    for _ in range(300):
        yaw = rng.uniform(-math.pi, math.pi) * law.takes_references
        exact = rng.choice([-1.0, 1.0, rng.uniform(-1.0, 1.0)], n) * sizes + resting[:, 2] * yaw
        x = np.concatenate([exact.astype(np.float32), np.zeros(len(single.wide), dtype=np.float32)])
        for k, i in enumerate(single.wide):
            x[n + k] = exact[i] - x[i]
        y = np.concatenate([rng.uniform(-1.0, 1.0, 3) * sizes[3:6], [0.0, 0.0, yaw]]).astype(np.float32)
        held = x[:n].astype(np.float64)
        held[list(single.wide)] += x[n:]
        after, command = single.step(x, y)
        following, expected = step(law, held, y.astype(np.float64))
        found = after[:n].astype(np.float64)
        found[list(single.wide)] += after[n:]
        worst = np.maximum(worst, np.abs(np.concatenate([found - following, command - expected])))
    slack = 1e-12 * np.max(np.abs(resting))  # doubles round too
    assert np.all(worst <= bounds + slack)
    assert np.max(worst[6:] / (bounds[6:] + 1e-30)) > 0.02  # the bound is not idle


def test_attitude_in_one_float_would_not_do():
    law, system, norms, case, box, form, reference = parts("pid-fair")
    plain = bound_rounding(system, norms, case, box, form._replace(wide=frozenset()), reference)
    assert math.degrees(float(plain.drift)) * 3600.0 / law.dt > 50.0 * ASKED_DEG


@pytest.mark.parametrize(("name", "words"), [("flagship", "near a limit"), ("hinf-rates", "not small")])
def test_a_heading_of_a_thousand_turns_is_refused(name, words):
    _, system, norms, case, box, form, reference = parts(name)
    with pytest.raises(Refusal, match=words):
        bound_rounding(system, norms, case, box, form._replace(heading=Fraction(6283)), reference)


def test_a_box_of_large_angles_is_refused():
    _, system, norms, case, box, form, reference = parts("flagship")
    tilted = [[*row[:X0], Fraction(4, 5), *row[X0 + 1 :]] for row in box]
    with pytest.raises(Refusal, match="reduction"):
        bound_rounding(system, norms, case, tilted, form, reference)
