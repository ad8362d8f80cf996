"""What a flight's records and its script say of its end."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_model.autopilot.modes import Mode
from firmware_model.config.events import ModeChange
from firmware_model.config.scenario import load_scenario
from firmware_model.recording.journal import RECORD
from gustproof.flight.routes.outcome import FlightOutcome, describe, infer_outcome

OFFBOARD, HOLD, STABILIZED = Mode.OFFBOARD, Mode.HOLD, Mode.STABILIZED
PLAIN = replace(load_scenario("paper"), duration_s=4.0)
SCRIPTED = replace(
    PLAIN,
    event=tuple(
        ModeChange(kind="mode", at_s=at_s, mode=mode)
        for at_s, mode in ((2.0, "hold"), (1.0, "hold"), (1.5, "offboard"))
    ),
)


def flown(*phases: tuple[Mode, float], samples: int = PLAIN.samples) -> np.ndarray:
    """Return records of a flight whose modes begin at these times."""
    records = np.zeros(samples, dtype=RECORD)
    records["thrust_z_command"] = -10.0
    for mode, at_s in phases:
        records["mode"][round(at_s * 250) :] = mode.value
    return records


WHOLE = flown((OFFBOARD, 0.0))
AS_ASKED = flown((OFFBOARD, 0.0), (HOLD, 1.0), (OFFBOARD, 1.5), (HOLD, 2.0))
TAKEN_LATER = flown((OFFBOARD, 0.0), (HOLD, 1.0), (OFFBOARD, 1.5), (HOLD, 1.8))
LOST = flown((OFFBOARD, 0.0), (STABILIZED, 3.0))


@pytest.mark.parametrize(
    ("records", "scenario", "outcome"),
    [
        (WHOLE, PLAIN, FlightOutcome.DONE),
        (WHOLE[:-1], PLAIN, FlightOutcome.CUT_OFF),
        (WHOLE[:0], PLAIN, FlightOutcome.CUT_OFF),
        (LOST, PLAIN, FlightOutcome.CONTROLLER_LOST),
        (LOST[:-1], PLAIN, FlightOutcome.CUT_OFF),
        (AS_ASKED, SCRIPTED, FlightOutcome.LEFT_OFFBOARD),
        (AS_ASKED, PLAIN, FlightOutcome.LEFT_OFFBOARD),
    ],
)
def test_records_alone_say_how_a_flight_ended(records, scenario, outcome):
    assert infer_outcome(records, scenario) is outcome


def test_motors_off_are_the_end_of_a_flight_that_landed():
    landed = AS_ASKED[:700].copy()
    assert infer_outcome(landed, SCRIPTED) is FlightOutcome.CUT_OFF
    landed["thrust_z_command"][-1] = -0.0
    assert infer_outcome(landed, SCRIPTED) is FlightOutcome.LEFT_OFFBOARD


def test_modes_that_the_script_asked_for_are_named():
    told = describe(FlightOutcome.LEFT_OFFBOARD, SCRIPTED, AS_ASKED)
    assert told == "flown as scripted: HOLD from 1 s, OFFBOARD from 1.5 s, HOLD from 2 s"


@pytest.mark.parametrize("records", [TAKEN_LATER, LOST, WHOLE])
def test_who_else_took_the_vehicle_is_not_the_script(records):
    assert describe(FlightOutcome.LEFT_OFFBOARD, SCRIPTED, records) == FlightOutcome.LEFT_OFFBOARD.value


def test_other_ends_are_told_as_they_are():
    assert describe(FlightOutcome.CONTROLLER_LOST, SCRIPTED, AS_ASKED) == FlightOutcome.CONTROLLER_LOST.value
