"""The command `gustproof audit`: tests of a simulator's physics."""

from pathlib import Path
from typing import Annotated

import typer

from gustproof.cli.failures import ExitStatus, exit_with
from gustproof.cli.options import AsJson, Build, print_json, working


def audit(
    simulator: Annotated[
        str,
        typer.Argument(
            help="own, rotorpy, ardupilot, px4, or a Python file whose make_simulator() returns an adapter."
        ),
    ],
    build: Build = "",
    as_json: AsJson = False,
) -> None:
    """Test the physics of a simulator against what it states of itself and against standards.

    Signs of axes and wind, gravity, thrust, rotor geometry, lag, gyroscopic term, turbulence and seeds. A quantity that
    the simulator neither takes nor tells is shown as not reachable. Exit status 1: a test failed, or all were not
    reachable.

        gustproof audit own

        gustproof audit rotorpy --json

        gustproof audit ardupilot --build ~/ardupilot

        gustproof audit px4 --build ~/PX4-Autopilot
    """
    from pydantic_core import to_jsonable_python

    from gustproof.show.report.audit import render_audit
    from gustproof.show.report.terminal import show
    from gustproof.studies.audit.adapters import load_simulator
    from gustproof.studies.audit.checks import AuditVerdict
    from gustproof.studies.audit.checks import audit as run

    audited = load_simulator(simulator, Path(build) if build else None)
    try:
        with working(f"auditing {audited.name}", quiet=as_json):
            rows = run(audited)
    finally:
        audited.close()
    if as_json:
        document = {"simulator": audited.name, "rows": rows}
        print_json(to_jsonable_python(document, inf_nan_mode="null"))
    else:
        show(render_audit(audited.name, rows))
    verdicts = {row.verdict for row in rows}
    if verdicts <= {AuditVerdict.NOT_REACHABLE}:
        raise exit_with(f"nothing was tested of {audited.name}", ExitStatus.REQUIREMENT_FAILED)
    if AuditVerdict.FAILED in verdicts:
        raise typer.Exit(ExitStatus.REQUIREMENT_FAILED.value)
