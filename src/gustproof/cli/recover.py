"""`gustproof recover`: recordings of flights that were cut off."""

import json
from pathlib import Path
from typing import Annotated

import typer


def recover(
    run: Annotated[Path, typer.Argument(help="Output folder of a flight that was cut off.", show_default=False)],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON on stdout, and nothing else.")] = False,
) -> None:
    """Make a run whole that was cut off by a power loss, a kill or a full disk: its bag, from its journal.

    At most one second of the flight is lost to a kill; the journal is removed once its bag is whole.

        gustproof recover runs/fly-003
    """
    from gustproof.report.terminal import render_flight, show
    from gustproof.simulate.recorder import recover as recovered

    flights = recovered(run)
    if as_json:
        print(json.dumps([flight.to_dict() for flight in flights], indent=2))
        return
    for flight in flights:
        show(render_flight(flight.message, flight.metrics, flight.bag, flight.requirements))
