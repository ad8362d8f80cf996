"""Laws at other sample times: there and back, against laws made at the new rate, and in the loop."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.vehicle import load_vehicle
from gustproof.airframe.hover import linear_law
from gustproof.errors import DesignError
from gustproof.law.discretize import central_law
from gustproof.law.form import Output, Provenance, list_laws, load_law
from gustproof.law.resample import resample
from gustproof.robust.lti.state_space import Lti
from gustproof.studies.rate.law_margins import resample_at_hover

STRAPDOWN = ("flagship", "flagship-robust", "indi", "pid-fair")
PARTS = ("A", "B", "C", "D", "G", "H")


@pytest.mark.parametrize("name", list_laws())
def test_a_law_returns_from_another_rate(name):
    law = load_law(name)
    back = resample(resample(law, 400.0), 250.0)
    for part in PARTS:
        assert np.allclose(getattr(back, part), getattr(law, part), rtol=1e-9, atol=1e-11)
    if law.rate_limit is not None:
        for part in "STUV":
            assert np.allclose(getattr(back.rate_limit, part), getattr(law.rate_limit, part), rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("name", list_laws())
def test_a_law_keeps_its_frequency_response_below_the_sample_rate(name):
    law, omega = load_law(name), np.geomspace(0.1, 40.0, 30)
    own = linear_law(law, inputs=law.D.shape[1]).response(omega)
    moved = linear_law(resample(law, 1000.0), inputs=law.D.shape[1]).response(omega)
    assert np.max(np.abs(moved - own) / np.max(np.abs(own), axis=(1, 2), keepdims=True)) < 0.06


@pytest.mark.parametrize("row", [6, 7, 11])
def test_a_law_that_reads_an_attitude_of_the_sample_before_returns_too(row):
    law = load_law("flagship")
    A = law.A.copy()
    A[row, 3:6] = 0.0
    law = replace(law, A=A)
    back = resample(resample(law, 400.0), 250.0)
    assert all(np.allclose(getattr(back, part), getattr(law, part), rtol=1e-9, atol=1e-11) for part in PARTS)


def test_a_central_law_becomes_the_one_made_at_the_new_rate():
    rng, axes = np.random.default_rng(3), np.eye(3)
    A = np.kron([[-0.1, 1.0, 0.0], [-3.0, -4.0, 2.0], [0.0, -1.0, -9.0]], axes)
    B, C = rng.normal(size=(9, 8)), np.kron([[-9.0, -5.0, 1.0]], axes)
    K = Lti(A=A, B=B, C=C, D=np.zeros((3, 8)))
    made = [
        central_law(
            "test",
            K,
            scheduled=True,
            dt=dt,
            limits=np.ones(3),
            output=Output.TORQUE,
            provenance=Provenance(design="", vehicle=""),
            rate_limits=np.full(3, 2.0),
        )
        for dt in (0.004, 0.0025)
    ]
    moved = resample(made[0], 400.0)
    for part in PARTS:
        assert np.allclose(getattr(moved, part), getattr(made[1], part), rtol=1e-11, atol=1e-13)
    for part in "STUV":
        assert np.allclose(getattr(moved.rate_limit, part), getattr(made[1].rate_limit, part), rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize("name", STRAPDOWN)
def test_the_strapdown_is_the_trapezoid_at_the_new_rate(name):
    law = resample(load_law(name), 400.0)
    half, n = 0.5 / 400.0, law.order
    expected = np.eye(6, n)
    expected[3:] = 0.0
    expected[:3, 3:6] = -half * np.eye(3)
    assert np.array_equal(law.A[:6], expected)
    assert np.array_equal(law.B[:6, :3], np.vstack([half * np.eye(3), np.eye(3)]))
    assert np.array_equal(law.G, 2.0 * half * np.eye(n, 3))


def test_the_loop_of_the_flagship_at_400_hz_is_no_worse():
    found = resample_at_hover(load_law("flagship"), 400, load_vehicle("paper"))
    assert found.after.Ms < found.before.Ms
    assert found.after.delay_margin > found.before.delay_margin


def test_its_own_rate_is_the_law_itself():
    law = load_law("pid-fair")
    assert resample(law, 250.0) is law


@pytest.mark.parametrize(("rate", "words"), [(100, "poor at 100 Hz"), (10, "unstable")])
def test_a_poor_or_unstable_rate_is_refused(rate, words):
    with pytest.raises((DesignError, ValueError), match=words):
        resample_at_hover(load_law("flagship"), rate, load_vehicle("paper"))


def test_a_law_without_continuous_origin_is_refused():
    law = load_law("hinf-d1")
    with pytest.raises(DesignError, match="pole at -1"):
        resample(replace(law, A=-np.eye(9)), 400.0)


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf])
def test_a_rate_that_is_none_is_refused(rate):
    with pytest.raises(ValueError, match="must be positive"):
        resample(load_law("hinf-d1"), rate)
