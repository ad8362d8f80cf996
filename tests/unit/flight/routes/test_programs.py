"""Ends of programs by the vehicle's summary, and the command that starts them."""

import pytest

from firmware_model.errors import ConfigError
from gustproof.flight.controllers.user_controller import parse_controller, split_command
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.flight.routes.programs import controller_command, describe_start, refine_outcome

LOST = FlightOutcome.CONTROLLER_LOST


def summary(*, links=True, answered=True, armed=True, mode="OFFBOARD", **counters):
    state = {"answered": answered, "armed": armed, "mode": mode}
    links = {"127.0.0.1:9": {}} if links else {}
    return {"state": state, "links": links, "counters": counters, "pace": None, "samples": 1000}


@pytest.mark.parametrize(
    ("facts", "words"),
    [
        (summary(links=False), "it sent the vehicle no message"),
        (summary(answered=False), "it answered no sample"),
        (summary(answered=False, early=3, stale=4), "it answered no sample, 7 set-points had a wrong stamp"),
        (summary(armed=False), "it did not arm the vehicle"),
        (summary(mode="STABILIZED"), "it did not enter OFFBOARD"),
        (summary(), "it stopped before the start"),
    ],
)
def test_flight_that_did_not_begin_says_how_far_the_controller_came(facts, words):
    assert describe_start(facts) == words


@pytest.mark.parametrize(
    ("outcome", "counters", "alone", "named"),
    [
        (LOST, {}, True, FlightOutcome.CONTROLLER_DIED),
        (LOST, {}, False, FlightOutcome.CONTROLLER_HUNG),
        (LOST, {"not_finite": 31}, True, FlightOutcome.CONTROLLER_NOT_FINITE),
        (FlightOutcome.DONE, {"not_finite": 1}, False, FlightOutcome.DONE),
        (FlightOutcome.LEFT_OFFBOARD, {}, True, FlightOutcome.LEFT_OFFBOARD),
    ],
)
def test_why_the_set_points_stopped_is_named(outcome, counters, alone, named):
    assert refine_outcome(outcome, summary(**counters), {}, alone=alone) is named


@pytest.mark.parametrize(("late", "named"), [(51, "CONTROLLER_LATE"), (50, "CONTROLLER_HUNG")])
def test_set_points_that_stopped_behind_the_clock_were_late(late, named):
    assert refine_outcome(LOST, summary(), {"late_samples": late}, alone=False) is FlightOutcome[named]


def test_words_are_split_without_a_shell_and_name_the_program():
    assert split_command("exec: sh -c 'a b' $HOME *") == ["sh", "-c", "a b", "$HOME", "*"]
    names = {"exec: sh": "sh", "exec: node --port=1.5 a/mine.mjs {address}": "mine", "exec: ./law --seed 3": "law"}
    assert {source: parse_controller(source).name for source in names} == names
    with pytest.raises(ConfigError, match="No closing quotation"):
        split_command("exec: sh 'a")


def test_program_is_started_under_its_guard_and_must_be_there():
    assert controller_command(parse_controller("exec: sh a {address}"), {}, real_time=True) == [
        "gustproof.flight.endpoint.guard", "sh", "a", "{address}",
    ]  # fmt: skip
    with pytest.raises(ConfigError, match="there is no program 'no-such-program'"):
        controller_command(parse_controller("exec: no-such-program"), {}, real_time=True)
