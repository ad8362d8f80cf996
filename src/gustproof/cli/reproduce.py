"""The command `gustproof reproduce`: flights and claims of the paper."""

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from gustproof.cli.options import Anyway, FigureData, FigureLook, VehicleName, print_json, progress
from gustproof.show.report.figure_style import FigureStyle, figures_as


class FigureFile(Enum):
    """Format of the figures."""

    PNG = "png"
    PDF = "pdf"
    SVG = "svg"
    PGF = "pgf"


def reproduce(
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="New folder for results [default: a fresh one in runs/].")
    ] = None,
    seeds: Annotated[
        int, typer.Option(min=1, help="Fly with the seeds 1 to this number; figures are medians over them.")
    ] = 3,
    vehicle: VehicleName = "paper",
    anyway: Anyway = False,
    figures: Annotated[FigureFile, typer.Option(help="Format of the figures.")] = FigureFile.PNG,
    style: FigureLook = FigureStyle.SCREEN,
    data: FigureData = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print summary.json on stdout, and nothing else.")] = False,
) -> None:
    """Fly the paper's scenarios with all shipped laws, over UDP in lockstep, and judge its claims.

    Write summary.json, report.txt, figures, the laws and one bag for each flight to the output folder.

        gustproof reproduce

        gustproof reproduce --figures pdf --style paper --data

        gustproof reproduce --seeds 1 --output /tmp/paper --json

    Another vehicle flies cascades tuned for it, beside those of the laws that are stable there.

        gustproof reproduce --vehicle iris
    """
    from firmware_model.config.uncertainty import load_vehicle_set
    from gustproof.flight.recording.folder import run_folder
    from gustproof.show.report.terminal import show
    from gustproof.show.reproduce import run as paper

    vehicles = load_vehicle_set(vehicle)
    with progress("starting", quiet=as_json) as show_progress:
        laws = paper.find_laws(vehicles, anyway=anyway, progress=show_progress)
        looks = figures_as(style, data=data, suffix=f".{figures.value}")
        with run_folder(output, "reproduce") as folder, looks:
            result = paper.reproduce(vehicles.nominal, range(1, seeds + 1), folder, show_progress, laws)
    if as_json:
        print_json(result.to_dict())
    else:
        show(result.render())
        print(f"results in {folder}: summary.json, report.txt, figures, bags, laws")
