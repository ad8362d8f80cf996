"""Outcomes of flights."""

from enum import Enum

import numpy as np

from firmware_model.autopilot.modes import Mode, Settings
from firmware_model.config.events import ModeChange
from firmware_model.config.scenario import Scenario
from firmware_model.recording.journal import record_blocks
from gustproof.flight.routes.upsets import divergence_s
from gustproof.types import Records

_OFFBOARD, _FAIL_SAFE = Mode.OFFBOARD.value, Mode[Settings().fail_safe.name].value

_Change = tuple[int, int]  # sample, and the mode from there on


class FlightOutcome(Enum):
    """End of a flight.

    Examples
    --------
    >>> from gustproof import FlightOutcome
    >>> FlightOutcome.DONE.value
    'flown to the end'
    """

    DONE = "flown to the end"
    """The law flew the whole scenario."""
    CONTROLLER_LOST = "the set-points stopped, at the controller or on the link; the fail-safe took the vehicle"
    """Set-points stopped in mid-flight; the on-board loop flew until OFFBOARD was set again, or to the end."""
    LEFT_OFFBOARD = "the vehicle left OFFBOARD; its on-board loop flew until OFFBOARD was set again"
    """Another client or the script set another mode; the law has not flown all of the scenario."""
    DIVERGED = "diverged"
    """The physics left what its steps can integrate: rates beyond some 2,800 rad/s, or no numbers."""
    CONTROLLER_RAISED = "the controller raised an error"
    """A step of a user's controller raised, or returned something else than three numbers."""
    CONTROLLER_NOT_FINITE = "the controller's command was not finite"
    """A step of a user's controller returned NaN or an infinite number."""
    CONTROLLER_HUNG = "the controller hung"
    """A step of a user's controller took longer than its time limit."""
    CONTROLLER_LATE = "the controller was late"
    """In real time, samples passed without a command in time; the last one was held."""
    CONTROLLER_DIED = "the controller's process died"
    """The process of a user's controller was killed, or crashed."""
    AUTOPILOT_LOST = "the autopilot's process ended in mid-flight"
    """The vehicle's process died."""
    NOT_STARTED = "the flight did not begin"
    """The controller never came to fly."""
    KILLED = "the autopilot's process ended"
    """A real autopilot died, or was killed."""
    HUNG = "the autopilot stopped answering"
    """A real autopilot left a sample without an answer."""
    WRONG_BUILD = "wrong build: not an autopilot that can be flown here"
    """The program of a real autopilot ended at once, or did not speak its protocol."""
    PORT_TAKEN = "port taken: another program uses one that the autopilot needs"
    """No instance of a real autopilot had its ports free."""
    WRONG_GEOMETRY = "wrong geometry: the rotors do not turn the vehicle as the autopilot means to"
    """Order, place or spin of the rotors differ between autopilot and vehicle file."""
    WRONG_PARAMETERS = "wrong parameters: the autopilot does not have those that were set"
    """Parameters did not reach a real autopilot, or it has others by that name: read back before take-off."""
    NOT_ARMED = "the autopilot did not arm"
    """A real autopilot refused; the message holds its own words."""
    UNSETTLED = "the autopilot did not hold the vehicle still in calm air"
    """A real autopilot's loops oscillate, or did not reach the height: the scenario did not begin."""
    DISARMED = "the autopilot disarmed in flight"
    """A real autopilot stopped its motors."""
    LEFT_MODE = "the autopilot left the mode that follows set-points"
    """A real autopilot went over to a mode of its own, such as a fail-safe."""
    GPS_LOST = "the autopilot gave up without satellites"
    """A real autopilot left its mode or disarmed while an event `gps_lost` lasted; the message tells how."""
    INTERRUPTED = "interrupted"
    """Ctrl-C."""
    CUT_OFF = "cut off; what its journal held has been recovered"
    """All of its processes were killed, or the machine was."""


ENTRY_FAILURES = frozenset(outcome for outcome in FlightOutcome if outcome.name.startswith("CONTROLLER_")) - {
    FlightOutcome.CONTROLLER_LOST
}
"""Ends of a flight by a fault of its controller."""

_WITHOUT_FLIGHT = {FlightOutcome.NOT_STARTED, FlightOutcome.INTERRUPTED}


def describe(outcome: FlightOutcome, scenario: Scenario, records: Records) -> str:
    """Return an outcome in words, with the time of a divergence, or the modes if the script alone ended OFFBOARD."""
    if outcome is FlightOutcome.DIVERGED and (diverged_s := divergence_s(records, scenario)) is not None:
        return f"diverged at {diverged_s:g} s: faster than the simulation can follow"
    changes, scripted = _mode_changes(records), _scripted_changes(scenario)
    left = _offboard_exits(changes)
    if outcome is not FlightOutcome.LEFT_OFFBOARD or not left or left - scripted:
        return outcome.value
    modes = (
        f"{Mode(mode).name} from {sample * scenario.dt:g} s" for sample, mode in changes if (sample, mode) in scripted
    )
    return f"flown as scripted: {', '.join(modes)}"


def infer_outcome(records: Records, scenario: Scenario) -> FlightOutcome:
    """Return the outcome of a flight from its records (n,) alone.

    It was flown to its end if no sample is missing, or if a landing ended it: then its motors are off. An unscripted
    change from OFFBOARD to the mode of the fail-safe counts as a fail-safe. A flight that diverged says no more.
    """
    if divergence_s(records, scenario) is not None:
        return FlightOutcome.DIVERGED
    landed = len(records) and records["mode"][-1] != _OFFBOARD and not records["thrust_z_command"][-1].any()
    if len(records) < scenario.samples and not landed:
        return FlightOutcome.CUT_OFF
    left = _offboard_exits(_mode_changes(records))
    if not left:
        return FlightOutcome.DONE
    lost = any(mode == _FAIL_SAFE for _, mode in left - _scripted_changes(scenario))
    return FlightOutcome.CONTROLLER_LOST if lost else FlightOutcome.LEFT_OFFBOARD


def blame_physics(outcome: FlightOutcome, records: Records, scenario: Scenario) -> FlightOutcome:
    """Return DIVERGED in place of the outcome of a flight whose records say so: what followed is no fault of others."""
    kept = outcome in _WITHOUT_FLIGHT or divergence_s(records, scenario) is None
    return outcome if kept else FlightOutcome.DIVERGED


def _mode_changes(records: Records) -> list[_Change]:
    """Return the first sample and the mode of each mode change; a flight begins in OFFBOARD."""
    changes, before, done = list[_Change](), np.array([_OFFBOARD]), 0
    for block in record_blocks(records):
        modes = block["mode"].astype(np.int64)
        changed = np.flatnonzero(np.diff(modes, prepend=before))
        changes += zip((done + changed).tolist(), modes[changed].tolist(), strict=True)
        before, done = modes[-1:], done + len(block)
    return changes


def _offboard_exits(changes: list[_Change]) -> set[_Change]:
    """Return the changes out of OFFBOARD."""
    before = [_OFFBOARD, *(mode for _, mode in changes)]
    return {change for was, change in zip(before, changes, strict=False) if was == _OFFBOARD}


def _scripted_changes(scenario: Scenario) -> set[_Change]:
    changes = (item for item in scenario.event if isinstance(item, ModeChange))
    return {(scenario.nearest_sample(item.at_s), Mode[item.mode.upper()].value) for item in changes}
