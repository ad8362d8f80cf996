"""Processes that control a vehicle over MAVLink: our own with a law, a foreign program under its guard."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from firmware_model.autopilot.modes import Mode
from firmware_model.errors import ConfigError
from firmware_model.mavlink.frames import RejectReason
from gustproof.entries.entry import Entry, EntryKind, Pilot, find_program
from gustproof.simulate.outcome import FlightOutcome

_WRONG_STAMPS = (RejectReason.EARLY.value, RejectReason.STALE.value)


def is_program(pilot: Pilot) -> bool:
    """Return whether a pilot is a foreign program."""
    return isinstance(pilot, Entry) and pilot.kind is EntryKind.PROGRAM


def controller_command(pilot: Pilot, law: Path, scenario: Path, *, real_time: bool) -> list[str]:
    """Return module and arguments of the Python process that controls; it reads the vehicle's address from its input.

    Raises
    ------
    ConfigError
        If the pilot is a program that is not there, or an object.
    """
    if isinstance(pilot, Entry) and pilot.kind is EntryKind.PROGRAM:
        return ["gustproof.controller.guard", *find_program(pilot.source)]
    if isinstance(pilot, Entry):
        raise ConfigError(f"controller '{pilot.source}': only programs fly in a process of their own")
    return [
        "gustproof.controller", "--json", "--exit-on-stdin-eof", "--law", str(law), "--connect", "-",
        "--scenario", str(scenario), *(["--real-time"] if real_time else []),
    ]  # fmt: skip


def describe_start(summary: Mapping[str, Any]) -> str:
    """Return how far a controller came whose flight did not begin, by the vehicle's summary."""
    state, counters = summary["state"], summary["counters"]
    if not summary["links"]:
        return "it sent the vehicle no message"
    if not state["answered"]:
        wrong = sum(counters.get(name, 0) for name in _WRONG_STAMPS)
        return f"it answered no sample{f', {wrong} set-points had a wrong stamp' if wrong else ''}"
    if not state["armed"]:
        return "it did not arm the vehicle"
    return "it did not enter OFFBOARD" if state["mode"] != Mode.OFFBOARD.name else "it stopped before the start"


def refine_outcome(outcome: FlightOutcome, summary: Mapping[str, Any], *, alone: bool) -> FlightOutcome:
    """Return why the set-points of a program stopped in mid-flight; other outcomes stay.

    It sent NaN, died and left the vehicle `alone` at the end, or hung.
    """
    if outcome is not FlightOutcome.CONTROLLER_LOST:
        return outcome
    if summary["counters"].get(RejectReason.NOT_FINITE.value, 0):
        return FlightOutcome.CONTROLLER_NOT_FINITE
    return FlightOutcome.CONTROLLER_DIED if alone else FlightOutcome.CONTROLLER_HUNG
