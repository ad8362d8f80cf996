"""The command `gustproof report`: flights or a campaign as an HTML page."""

from pathlib import Path
from typing import Annotated

import typer

from firmware_model.errors import ConfigError


def report(
    runs: Annotated[
        list[Path], typer.Argument(help="Folders of `gustproof fly --out` or bags, or the table of one campaign.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Write the page here (.html).")] = Path("report.html"),
) -> None:
    """Write one page on some flights: figures, linked time histories, margins, spectra, a 3D replay.

    The page is one HTML file that opens without a network. Every group of charts can be saved as PNG.

        gustproof fly paper --law hinf-d1 --out run1

        gustproof fly paper --law pid-fair --out run2

        gustproof report run1 run2 -o report.html

    For a campaign's table the page shows the distributions of all figures by law, their causes, and the worst runs.

        gustproof report mc.parquet -o mc.html
    """
    if output.suffix != ".html":
        raise ConfigError(f"{output}: a report ends in .html")
    if not output.parent.is_dir():
        raise ConfigError(f"{output.parent}: no such folder")
    if output.exists():
        raise ConfigError(f"{output}: exists already; nothing is overwritten")
    if any(run.suffix == ".parquet" for run in runs):
        _report_campaign(runs, output)
        return
    from gustproof.report.html.page import write_report
    from gustproof.report.html.runs import read_runs

    flights = read_runs(runs)
    write_report(flights, output)
    print(f"{len(flights)} flight{'s' if len(flights) != 1 else ''} in {output}")


def _report_campaign(tables: list[Path], output: Path) -> None:
    from gustproof.report.html.campaign_page import write_campaign_report

    if len(tables) > 1:
        raise ConfigError(f"{', '.join(map(str, tables))}: a page shows one campaign, or flights")
    write_campaign_report(tables[0], output)
    print(f"the campaign of {tables[0]} in {output}")
