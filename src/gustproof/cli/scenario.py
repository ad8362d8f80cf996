"""The command `gustproof scenario`: list, show, check and extract scenarios."""

from pathlib import Path
from typing import Annotated

import typer

from firmware_model.errors import ConfigErrors
from gustproof.cli.failures import ExitStatus, exit_with
from gustproof.cli.options import Force, check_output, complete

scenario = typer.Typer(no_args_is_help=True, help="List, show and check scenarios, and extract the wind of a flight.")


@scenario.command()
def check(
    file: Annotated[
        str,
        typer.Argument(
            help="A .toml file, or the name of a shipped one.", show_default=False, autocompletion=complete("scenario")
        ),
    ],
) -> None:
    """Validate a scenario; print one line for each error, with its key and what is allowed, and exit with status 2.

    A table without effect is an error too: an event after the end, the drift of a vehicle that is held.

    gustproof scenario check mine.toml
    """
    from firmware_model.config.scenario import load_scenario
    from gustproof.show.report.catalogue import describe_scenario

    try:
        script = load_scenario(file)
        if script.unflown:
            raise ConfigErrors(file, script.unflown)
    except ConfigErrors as errors:
        exits = [exit_with(line, ExitStatus.BAD_INPUT) for line in errors.lines]
        raise exits[-1] from None
    print(describe_scenario(script))


@scenario.command()
def extract(
    run: Annotated[Path, typer.Argument(help="Output folder of a flight, or its bag.", show_default=False)],
    output: Annotated[Path, typer.Option("-o", "--output", help="New file (.csv) for `replay` in a scenario.")],
    moment: Annotated[
        bool, typer.Option("--moment", help="Write the whole disturbance moment instead of the gusts.")
    ] = False,
    force: Force = False,
) -> None:
    """Write the gusts of a recorded flight as CSV, for a replay in your own scenario.

        gustproof scenario extract runs/fly-001 -o wind.csv

    In the scenario, use [[wind]] with kind = "replay" and file = "wind.csv".
    """
    from gustproof.flight.recording.bag import read_bag
    from gustproof.flight.recording.folder import find_bag
    from gustproof.flight.recording.replay import save_replay

    check_output(output, ".csv", "a replay")
    _, records = read_bag(find_bag(run))
    save_replay(records, "moment" if moment else "wind", output)
    print(f"{len(records)} samples in {output}")
