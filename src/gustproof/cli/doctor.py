"""The command `gustproof doctor`: a checkup of this installation."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

from gustproof.cli.failures import ExitStatus, exit_with, say
from gustproof.cli.options import AsJson, print_json, print_next, working

if TYPE_CHECKING:
    from gustproof.flight.routes.checkup import Check


def doctor(as_json: AsJson = False) -> None:
    """Check this installation: versions, folder, ports, compile cache, real-time rights, autopilots, a test flight.

    Each line is OK, absent, warning or fault, with the remedy. Absent is what one option alone needs. A warning leaves
    flights as they are: something is slower, or one option is missing. The first run after an installation compiles
    the simulator, which takes up to a minute.

        gustproof doctor

        gustproof doctor --json

    Exit status: 0 without a fault, 1 with one.
    """
    from gustproof.flight.routes.checkup import CHECKS, Status

    done: list[Check] = []
    for subject, run in CHECKS:
        with working(f"checking {subject}", quiet=as_json):
            found = run()
        done += found
        if not as_json:
            _show(found)
    faults = [check for check in done if check.status is Status.FAULT]
    if as_json:
        checks = [check._asdict() | {"status": check.status.value.lower()} for check in done]
        print_json({"sound": not faults, "checks": checks})
    if faults:
        names = ", ".join(check.name for check in faults)
        raise exit_with(f"{len(faults)} of {len(done)} checks failed: {names}", ExitStatus.REQUIREMENT_FAILED)
    if not as_json:
        print_next("fly", "gust-roll")


def _show(checks: "Iterable[Check]") -> None:
    for check in checks:
        say(f"{check.status.value:8} {check.name:14} {check.found}")
        if check.advice:
            say(f"{'':23} do: {check.advice}")
