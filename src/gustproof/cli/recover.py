"""The command `gustproof recover`: bags of interrupted flights."""

from pathlib import Path
from typing import Annotated

import typer

from gustproof.cli.options import AsJson, print_json, working


def recover(
    run: Annotated[Path, typer.Argument(help="Output folder of an interrupted flight.", show_default=False)],
    as_json: AsJson = False,
) -> None:
    """Write the bag of a flight that a power loss, a kill or a full disk interrupted, from its journal.

    A kill loses at most one second of the flight. The journal is removed once the bag is complete.

        gustproof recover runs/fly-003
    """
    from gustproof.report.terminal import render_flight, show
    from gustproof.simulate.recorder import recover as recovered

    with working(f"recovering {run}", quiet=as_json):
        flights = recovered(run)
    if as_json:
        print_json([flight.to_dict() for flight in flights])
        return
    for flight in flights:
        show(render_flight(flight.message, flight.metrics, flight.bag, flight.requirements, own_view=flight.own_view))
