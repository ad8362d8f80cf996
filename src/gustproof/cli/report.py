"""`gustproof report`: what was flown, as a page."""

from pathlib import Path
from typing import Annotated

import typer

from firmware_model.errors import ConfigError


def report(
    runs: Annotated[list[Path], typer.Argument(help="Folders of `gustproof fly --out`, or bags.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Write the page here (.html).")] = Path("report.html"),
) -> None:
    """Put flights on one page that opens anywhere: figures, linked time histories, margins, spectra, a 3D replay.

    One HTML file that asks nobody for anything; every group of charts can be saved as PNG.

        gustproof fly paper --law hinf-d1 --out run1

        gustproof fly paper --law pid-fair --out run2

        gustproof report run1 run2 -o report.html
    """
    from gustproof.report.html import write_report
    from gustproof.report.html_runs import read_runs

    if output.suffix != ".html":
        raise ConfigError(f"{output}: a report ends in .html")
    if not output.parent.is_dir():
        raise ConfigError(f"{output.parent}: no such folder")
    flights = read_runs(runs)
    write_report(flights, output)
    print(f"{len(flights)} flight{'s' if len(flights) != 1 else ''} in {output}")
