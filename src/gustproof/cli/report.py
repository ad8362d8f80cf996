"""The command `gustproof report`: a log, flights or a campaign as an HTML page."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.flights import complete_recordings
from gustproof.cli.options import (
    AsJson,
    FlightBegin,
    FlightEnd,
    Force,
    check_output,
    print_json,
    print_next,
    progress,
    working,
)
from gustproof.flight.recording.folder import find_bag, find_bags
from gustproof.flight.recording.layout import LAYOUTS, save_layout

ULOG = ".ulg"
"""Ending of a log of PX4."""

if TYPE_CHECKING:
    from collections.abc import Sequence

    from firmware_model.config.scenario import Scenario
    from gustproof.show.report.html.runs import ReportRun


def report(
    runs: Annotated[
        list[Path],
        typer.Argument(
            help="A log of PX4, ArduPilot or others, folders of `gustproof fly --output` or bags, or the table of one "
            "campaign."
        ),
    ],
    output: Annotated[
        Path,
        typer.Option("-o", "--output", help="Write the page here (.html), a layout (.json, .xml), or a ULog (.ulg)."),
    ] = Path("report.html"),
    begin: FlightBegin = None,
    end: FlightEnd = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Write one page on a log or some flights: figures, linked time histories, margins, spectra, a 3D replay.

    The page is one HTML file that opens without a network. On a log it shows set-points over what was flown, step
    responses, vibration and filters, the vehicle, and the judgement of the gains that flew. For a campaign's table it
    shows the distributions of all figures by law, their causes, and the worst runs. Other viewers open the bags:
    -o layout.json is a layout for Foxglove, -o layout.xml one for PlotJuggler. -o flight.ulg writes one flight as ULog,
    a log of PX4. A flight that a power loss, a kill or a full disk cut off is completed from its journal first.

        gustproof report flight.ulg
        gustproof report run1 run2 -o report.html
        gustproof report run1 -o layout.json
        gustproof report mc.parquet -o mc.html
    """
    check_output(output, (".html", ULOG, *LAYOUTS), "a report, a layout or a ULog")
    if logs := [run for run in runs if run.is_file() and run.suffix not in (".parquet", ".mcap")]:
        if len(runs) > 1 or output.suffix != ".html":
            raise ConfigError(f"{logs[0]}: a log has a page (.html) of its own")
        _report_log(logs[0], output, begin, end, as_json=as_json)
        return
    if (as_json, begin, end) != (False, None, None):
        raise ConfigError(
            "--json, --from, --to: of a log alone; figures of flights are those of `gustproof fly --json`"
        )
    for run in runs:
        complete_recordings(run)
    if output.suffix != ".html":
        _WRITERS[output.suffix](runs, output)
    elif any(run.suffix == ".parquet" for run in runs):
        _report_campaign(runs, output)
    else:
        _report_flights(runs, output)


def _write_layout(runs: list[Path], output: Path) -> None:
    for run in runs:
        find_bags(run)
    save_layout(output)
    print(f"layout for the bags in {', '.join(map(str, runs))} in {output}")


def _write_ulog(runs: list[Path], output: Path) -> None:
    from gustproof.flight.recording.bag import read_bag, read_estimate_topics
    from gustproof.flight.recording.px4_log import write_ulog
    from gustproof.flight.routes.flight import parse_metadata

    if len(runs) > 1:
        raise ConfigError(f"{', '.join(map(str, runs))}: a ULog holds one flight")
    bag = find_bag(runs[0])
    with working(f"writing {output}", quiet=False):
        metadata, records = read_bag(bag)
        scenario, controller, vehicle, seed, _ = parse_metadata(metadata, bag)
        flown = "" if controller is None else controller.name
        about = {"scenario": scenario.name, "controller": flown, "seed": str(seed)}
        write_ulog(output, records, vehicle, scenario, about, read_estimate_topics(bag))
    print(f"{bag} in {output}")


_WRITERS = {ULOG: _write_ulog, **dict.fromkeys(LAYOUTS, _write_layout)}


def _report_flights(runs: list[Path], output: Path) -> None:
    from gustproof.show.report.html.page import write_report
    from gustproof.show.report.html.runs import read_runs

    with working(f"writing {output}", quiet=False):
        flights = read_runs(runs)
        write_report(flights, output)
    print(f"{len(flights)} flight{'s' if len(flights) != 1 else ''} in {output}")
    _print_next(flights)


def _report_campaign(runs: list[Path], output: Path) -> None:
    from gustproof.show.report.html.campaign_page import write_campaign_report

    if len(runs) > 1:
        raise ConfigError(f"{', '.join(map(str, runs))}: a page shows one campaign, or flights")
    with working(f"writing {output}", quiet=False):
        write_campaign_report(runs[0], output)
    print(f"the campaign of {runs[0]} in {output}")


def _report_log(path: Path, output: Path, begin: float | None, end: float | None, *, as_json: bool) -> None:
    from gustproof.logs.read.flown_part import crop
    from gustproof.logs.read.read_log import read_log
    from gustproof.show.report.html.log_page import write_log_report
    from gustproof.show.report.log_summary import flight_document, render_flight
    from gustproof.show.report.terminal import show
    from gustproof.studies.logged_flight import study_log

    with progress(f"reading {path}", quiet=as_json) as shown:
        found = study_log(crop(read_log(path), begin, end), path.stem, progress=shown)
    write_log_report(found, output)
    if as_json:
        print_json(flight_document(found) | {"page": str(output)})
        return
    show(render_flight(found))
    print(f"the flight of {path} in {output}")
    if found.shown is not None and found.shown.file is not None:
        span = [word for name, at in (("--from", begin), ("--to", end)) if at is not None for word in (name, f"{at:g}")]
        print_next("identify", path, *span, "-o", "my-quad.toml", "--like", "iris")


def _print_next(flights: "Sequence[ReportRun]") -> None:
    excited = [each.bag for each in flights if _excites_all_axes(each.scenario)]
    if excited:
        print_next("identify", excited[0], "-o", "my-quad.toml")
    elif not any(each.autopilot for each in flights):
        print_next("fly", "doublets")


def _excites_all_axes(scenario: "Scenario") -> bool:
    """Return whether set-points move roll, pitch and yaw, as a vehicle's identification wants."""
    return all(len(set(angles)) > 1 for angles in zip(*(euler for _, euler in scenario.references), strict=True))
