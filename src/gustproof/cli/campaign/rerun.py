"""The command `gustproof campaign rerun`: a run of a campaign, flown again over UDP."""

from typing import TYPE_CHECKING, Annotated

import typer

from gustproof.cli.flights import (
    Comparison,
    NewFolder,
    NoTlog,
    Same,
    Session,
    View,
    choose_autopilot,
    confirm_flown,
)
from gustproof.cli.options import AsJson, AutopilotName, Build, Params

if TYPE_CHECKING:
    from gustproof.flight.routes.flight import Flight
    from gustproof.studies.campaign.rerun import CampaignRun


def rerun(
    context: typer.Context,
    run: Annotated[str, typer.Argument(help="Table and number of the run: mc.parquet:471.", show_default=False)],
    controller: Same = None,
    autopilot: AutopilotName = None,
    build: Build = "",
    params: Params = "",
    view: View = False,
    no_tlog: NoTlog = False,
    output: NewFolder = None,
    as_json: AsJson = False,
) -> None:
    """Fly a run of a campaign again over UDP, record it, and compare its figures to the bit.

    A table starts no program: name what is no law again, by --controller, or --autopilot and --build. Exit status:
    0 equal, 1 it differs.

        gustproof campaign rerun mc.parquet:471
    """
    from gustproof.studies.campaign.rerun import find_run

    chosen, found = choose_autopilot(context, autopilot, build, params), find_run(run)
    plan = confirm_flown(found.plan, controller, chosen, found.table)

    def compare(flight: "Flight") -> Comparison:
        return _compare(found, flight)

    Session([plan], compare, tlog=not no_tlog, as_json=as_json).run(output, view=view)


def _compare(found: "CampaignRun", flight: "Flight") -> Comparison:
    name = f"run {found.row['run']} of {found.table}"
    if found.row["failure"] is not None:
        return None, f"{name} left no figures: not compared"
    if differences := found.differences(flight):
        return False, f"differs from {name} in {', '.join(differences)}"
    return True, f"equal to {name} in every bit of its figures"
