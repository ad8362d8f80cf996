from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.requirement import Metric, Requirement
from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.recording.journal import RECORD
from gustproof.show.live.requirement_status import requirement_status

VEHICLE = load_vehicle("paper")


@pytest.fixture
def scenario() -> Scenario:
    required = (
        Requirement(metric=Metric.TORQUE_PEAK, at_most=1.0, to_s=0.4),
        Requirement(metric=Metric.TORQUE_PEAK, at_most=0.1, to_s=0.4, axis="roll"),
        Requirement(metric=Metric.PEAK, at_most=1.0, at_least=0.0),
    )
    return replace(load_scenario("calm"), duration_s=1.0, require=required)


def flown(samples: int) -> np.ndarray:
    records = np.zeros(samples, dtype=RECORD)
    records["q_NB"][:, 0] = 1.0
    records["torque_command_B"][:, 0] = 0.5
    return records


@pytest.mark.parametrize(
    ("samples", "over", "held"),
    [
        (0, False, [None, None, None]),
        (99, False, [None, None, None]),
        (100, False, [True, False, None]),
        (250, True, [True, False, True]),
        (150, True, [True, False, False]),
        (0, True, [False, False, False]),
    ],
)
def test_light_is_dark_until_its_window_is_flown(scenario, samples, over, held):
    shown = requirement_status(flown(samples), scenario, VEHICLE, over=over)
    assert [light["held"] for light in shown] == held


def test_light_says_what_is_required(scenario):
    shown = requirement_status(flown(250), scenario, VEHICLE, over=False)
    assert [light["text"] for light in shown] == [
        "torque peak ≤ 1 N m, 0 s to 0.4 s",
        "torque peak, roll ≤ 0.1 N m, 0 s to 0.4 s",
        "peak ≥ 0 ≤ 1 deg",
    ]
    assert [light["value"] for light in shown] == [0.5, 0.5, 0.0]


def test_used_envelope_is_shown_in_percent(scenario):
    required = (Requirement(metric=Metric.RHO, at_most=1.0),)
    (shown,) = requirement_status(flown(250), replace(scenario, require=required), VEHICLE, over=True)
    assert shown == {"text": "envelope used ≤ 100 %", "value": 0.0, "held": True}


@pytest.mark.parametrize(
    ("required", "text"),
    [
        (
            {"metric": Metric.RECOVERY, "axis": "roll", "within_deg": 0.3, "from_s": 0.2},
            "roll back within 0.3 deg ≤ 1.5 s, 0.2 s to end",
        ),
        ({"metric": Metric.SATURATED, "at_most": 0.0}, "torque never saturated"),
    ],
)
def test_light_says_so_in_words(scenario, required, text):
    wanted = replace(scenario, require=(Requirement(**{"at_most": 1.5, **required}),))
    assert requirement_status(flown(100), wanted, VEHICLE, over=False)[0]["text"] == text
