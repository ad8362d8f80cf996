from dataclasses import replace

import numpy as np

from firmware_model.config.events import AttitudeReference
from firmware_model.config.scenario import load_scenario
from gustproof.law.references import references


def test_a_part_of_the_references_is_that_of_the_whole_flight() -> None:
    steps = ((0.02, (10.0, 0.0, 0.0)), (0.05, (0.0, -20.0, 0.0)))
    events = tuple(AttitudeReference(kind="attitude", at_s=at_s, euler_deg=euler) for at_s, euler in steps)
    scenario = replace(load_scenario("calm"), duration_s=0.1, event=events)
    whole = references(scenario)
    expected = [(0.0, 0.0, 0.0)] * 5 + [(10.0, 0.0, 0.0)] * 8 + [(0.0, -20.0, 0.0)] * 12  # at samples 5 and 13
    np.testing.assert_allclose(np.degrees(whole), expected, atol=1e-12)
    for begin, end in ((0, 25), (3, 9), (5, 6), (6, 20), (14, 25)):
        assert np.array_equal(references(scenario, begin, end), whole[begin:end])
