"""Processes that control a vehicle over MAVLink: our own with a law, an external program under its guard."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from firmware_model.autopilot.modes import Mode
from firmware_model.mavlink.reasons import RejectReason
from gustproof.flight.controllers.user_controller import Controller, ControllerKind, UserController, find_program
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.law.form import Law

_MOST_HELD = 0.05
"""[-] share of the samples of a flight in real time that may pass without a command in time."""
_WRONG_STAMPS = (RejectReason.EARLY.value, RejectReason.STALE.value)


def is_program(controller: Controller) -> bool:
    """Return whether a controller is an external program."""
    return isinstance(controller, UserController) and controller.kind is ControllerKind.PROGRAM


def controller_command(
    controller: Controller, files: Mapping[str, Path], *, real_time: bool, level: bool = False
) -> list[str]:
    """Return module and arguments of the Python process that controls; it reads the vehicle's address from its input.

    `files` are those that it reads: law, scenario, and nominal vehicle. A law that flies `level`, without references,
    starts sooner, as it needs no scenario.

    Raises
    ------
    ConfigError
        If the controller is a program that is not there, or a controller that its user did not name.
    """
    if isinstance(controller, UserController):
        controller.check_given()
    if isinstance(controller, Law):
        flown = ["--law", str(files["law"]), *([] if level else ["--scenario", str(files["scenario"])])]
    elif controller.kind is ControllerKind.PROGRAM:
        return ["gustproof.flight.endpoint.guard", *find_program(controller.source)]
    else:
        read = ["--vehicle", str(files["nominal"]), "--scenario", str(files["scenario"])]
        flown = ["--controller", controller.source, *read]
    options = ["--json", "--exit-on-stdin-eof", *(["--real-time"] if real_time else [])]
    return ["gustproof.flight.endpoint", *options, *flown, "--connect", "-"]


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


def refine_outcome(
    outcome: FlightOutcome, vehicle: Mapping[str, Any], controller: Mapping[str, Any], *, alone: bool
) -> FlightOutcome:
    """Return why a user's controller sent no set-points in mid-flight, or sent them late; other outcomes stay.

    `vehicle` and `controller` are the summaries of these processes. The controller tells its own failure, or died if
    the vehicle was `alone` at the end. Otherwise it sent NaN, fell behind the clock, or hung.
    """
    most = _MOST_HELD * vehicle["samples"]
    if outcome is FlightOutcome.DONE and vehicle["pace"]:
        return FlightOutcome.CONTROLLER_LATE if vehicle["pace"]["held"] > most else outcome
    if outcome is not FlightOutcome.CONTROLLER_LOST:
        return outcome
    named = f"CONTROLLER_{controller.get('outcome', '').upper()}"
    if named in FlightOutcome.__members__:
        return FlightOutcome[named]
    if vehicle["counters"].get(RejectReason.NOT_FINITE.value, 0):
        return FlightOutcome.CONTROLLER_NOT_FINITE
    if controller.get("late_samples", 0) > most:  # so late that its answers were taken for none
        return FlightOutcome.CONTROLLER_LATE
    is_dead = alone and "outcome" not in controller  # one that tells its end was alive when the set-points stopped
    return FlightOutcome.CONTROLLER_DIED if is_dead else FlightOutcome.CONTROLLER_HUNG
