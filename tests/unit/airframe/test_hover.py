"""The loop at hover: stable for every shipped law on its own vehicle, and not for what can't be."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.link_faults import Jitter, LinkDelay
from firmware_model.config.scenario import list_scenarios, load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.airframe.hover import is_stable_at_hover, link_delay_samples
from gustproof.law.form import Output, list_laws, load_law

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


def late(kind: str, amount_s: float, direction: str = "to_vehicle", **window: float):
    name = {"delay": "delay_s", "jitter": "most_s"}[kind]
    table = LinkDelay if kind == "delay" else Jitter
    return table(kind=kind, direction=direction, **{name: amount_s}, **window)


@pytest.mark.parametrize(
    ("link", "always", "most"),
    [
        ((), 0, 0),
        ((late("delay", 0.04),), 10, 10),
        ((late("delay", 0.02), late("delay", 0.02, "to_controller")), 10, 10),
        ((late("delay", 0.006), late("delay", 0.003, "to_controller")), 2, 2),  # whole samples of the sum
        ((late("delay", 0.04, stop_s=12.0),), 10, 10),  # to the end
        ((late("delay", 0.04, start_s=1.0),), 0, 10),
        ((late("delay", 0.04, stop_s=5.0), late("delay", 0.02, start_s=5.0)), 0, 10),
        ((late("delay", 0.04, stop_s=5.1), late("delay", 0.02, start_s=5.0)), 0, 15),
        ((late("delay", 0.04, start_s=13.0),), 0, 0),  # after the flight
        ((late("jitter", 0.06), late("delay", 0.004)), 1, 16),
    ],
)
def test_delays_of_the_link_count_in_samples(link, always, most):
    scenario = replace(load_scenario("calm"), duration_s=12.0, link=link)
    assert link_delay_samples(scenario) == (always, most)


def test_constant_delay_of_the_link_is_that_of_the_commands():
    calm, flagship = load_scenario("calm"), load_law("flagship")
    for samples in range(1, 12):
        linked = replace(calm, link=(late("delay", 0.004 * (samples - 1)),)) if samples > 1 else calm
        delayed = replace(calm, delay_samples=samples)
        assert is_stable_at_hover(flagship, PAPER, linked) is is_stable_at_hover(flagship, PAPER, delayed)
