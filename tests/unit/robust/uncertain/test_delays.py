"""Delays as linear systems."""

import math

import numpy as np
import pytest

from gustproof.robust.uncertain.delays import uncertain_delay
from gustproof.robust.uncertain.elements import ureal

EXACT = 1e-12


@pytest.mark.parametrize(("order", "phase"), [(1, 0.6), (2, 1.7)])
def test_an_uncertain_delay_has_unit_gain_and_the_phase_it_should(order, phase):
    model = uncertain_delay(ureal("T", range=(0.002, 0.01)), order=order)
    assert model.n_w == order
    for T in (0.002, 0.007):
        response = model.member(model.delta({"T": T})).response(phase / T)[0, 0, 0]
        assert abs(response) == pytest.approx(1.0, rel=EXACT)
        assert -np.angle(response) == pytest.approx(phase, abs=math.radians(1.2))
