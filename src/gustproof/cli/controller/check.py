"""The command `gustproof controller check`: what a controller does wrong, by name."""

from typing import Annotated

import typer

from gustproof.cli.failures import ExitStatus, exit_with, say
from gustproof.cli.laws import find_controller
from gustproof.cli.options import AsJson, VehicleName, print_json, progress


def check(
    controller: Annotated[
        str,
        typer.Argument(help="'exec: COMMAND' of a program that speaks MAVLink, FILE.py:MAKER, LIBRARY.so, or a law."),
    ],
    vehicle: VehicleName = "paper",
    as_json: AsJson = False,
) -> None:
    """Check how a controller keeps to the protocol: handshake, stamps, deadlines, units, refusals.

    It is started against a vehicle on this machine and flies twice for some seconds, in lockstep and in real time. A
    few of its answers are lost on purpose. A kick turns the vehicle: units and signs show in the response. A unit that
    is wrong by less than about ten times looks like another tuning, and is not found.

    A program gets the vehicle's address in GUSTPROOF_ADDRESS, and in place of {address} in its words. Its last line on
    stderr is told when it dies. Each finding has a name, what was seen, and what the protocol asks.

    Exit status: 0 no finding, 1 a finding, 2 bad input.

        gustproof controller check "exec: node mine.mjs"
        gustproof controller check my_mpc.py:make --vehicle my-quad.toml --json
    """
    from firmware_model.config.vehicle import load_vehicle
    from gustproof.flight.protocol_check import inspection

    flown = load_vehicle(vehicle)
    found = find_controller(controller, flown)
    with progress("check", quiet=as_json) as shown:
        findings = inspection.check_controller(found, vehicle=flown, progress=shown)
    if as_json:
        print_json({"controller": found.name, "findings": [finding.to_dict() for finding in findings]})
    for finding in () if as_json else findings:
        say(f"{finding.name}: {finding.seen} ({finding.trial})")
        say(f"    the protocol asks: {finding.asked}")
    if findings:
        names = ", ".join(finding.name for finding in findings)
        raise exit_with(f"'{found.name}': {names}", ExitStatus.REQUIREMENT_FAILED)
    if not as_json:
        say(f"'{found.name}' keeps to the protocol")
