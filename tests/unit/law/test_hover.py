"""The loop at hover: stable for every shipped law on its own vehicle, and not for what can't be."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.scenario import list_scenarios, load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.law.form import Output, list_laws, load_law
from gustproof.law.hover import is_stable_at_hover

PAPER, IRIS = load_vehicle("paper"), load_vehicle("iris")


@pytest.mark.slow
@pytest.mark.parametrize("name", list_laws())
def test_is_stable_at_hover_of_each_shipped_law_in_each_scenario(name):
    law = load_law(name)
    stable = {is_stable_at_hover(law, PAPER, scenario) for scenario in map(load_scenario, list_scenarios())}
    assert stable == {None if law.output is Output.RATES else True}


def test_is_stable_at_hover_tells_another_vehicle_and_too_much_delay():
    calm = load_scenario("calm")
    assert is_stable_at_hover(load_law("pid-fair"), IRIS, calm) is False
    assert is_stable_at_hover(load_law("pid-default"), IRIS, calm) is True
    # The proof of instability by hand: nine samples of delay in all are too many for the flagship.
    flagship = load_law("flagship")
    assert is_stable_at_hover(flagship, PAPER, replace(calm, delay_samples=8)) is True
    assert is_stable_at_hover(flagship, PAPER, replace(calm, delay_samples=9)) is False


def test_is_stable_at_hover_tells_a_law_that_grows_by_itself():
    law = load_law("hinf-d1")
    assert is_stable_at_hover(replace(law, A=2.0 * np.eye(law.order)), PAPER, load_scenario("calm")) is False
