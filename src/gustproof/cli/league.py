"""The command `gustproof league`: entries flown in the same seeds, and ranked."""

from pathlib import Path
from typing import Annotated

import typer

from gustproof.cli.failures import ExitStatus, exit_with
from gustproof.cli.options import COMPILING, AsJson, Force, check_output, print_json, progress, working


def league(
    output: Annotated[Path, typer.Option("-o", "--output", help="Write the page here (.html).")],
    entry: Annotated[
        list[str] | None,
        typer.Option(
            help="A law by name, NAME@PEAK, a law file, MODULE.py:MAKER or LIBRARY.so; {vehicle} in a file's name "
            "stands for the vehicle's. Repeat it [default: all, which are 15 laws].",
            show_default=False,
        ),
    ] = None,
    vehicle: Annotated[
        list[str] | None, typer.Option(help="A vehicle; repeat it [default: paper, octo, iris].", show_default=False)
    ] = None,
    scenario: Annotated[
        list[str] | None,
        typer.Option(help="A scenario of the league, or a .toml file; repeat it [default: all].", show_default=False),
    ] = None,
    runs: Annotated[int, typer.Option(min=1, max=1000, help="Flights of each entry in each scenario.")] = 8,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all flights.")] = 1,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Worker processes [default: one for each core].", show_default=False)
    ] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Fly entries in the same seeds, measure their operating points, and rank them with confidence.

    Entries are laws tuned for each vehicle, law files, C libraries and Python objects. The score is the attitude error
    over that of `pid-fair`, over all scenarios and vehicles. Entries compete within classes, whose bounds on Ms,
    margins and torque slew are measured by flights.

        gustproof league --entry flagship --entry pid-fair --entry my_mpc.py:make -o league.html

    The folder `league.work` beside the page keeps finished work: the same command resumes, and one with more entries or
    runs flies only those. The same seed gives the same bits.
    """
    from firmware_model.config.uncertainty import load_vehicle_set
    from gustproof.flight.routes.batch import is_cold
    from gustproof.show.report.html.league_page import write_league_page
    from gustproof.show.report.league import render_league
    from gustproof.show.report.terminal import show
    from gustproof.studies.campaign.executors import count_cores, process_pool
    from gustproof.studies.league.course import COURSE, FLEET, load_course
    from gustproof.studies.league.entries import ALL, parse_league_entries
    from gustproof.studies.league.study import LeaguePlan, fly_league

    check_output(output, ".html", "a page")
    folder = output.with_suffix(".work")
    plan = LeaguePlan(
        entries=parse_league_entries(entry or [ALL]),
        vehicles=tuple(map(load_vehicle_set, vehicle or FLEET)),
        scenarios=tuple(load_course(scenario or COURSE)),
        runs=runs,
        seed=seed,
    )
    begun = COMPILING * any(map(is_cold, plan.scenarios))
    try:
        with (
            process_pool(workers or count_cores()) as pool,
            progress(f"{len(plan.entries)} entries{begun}", quiet=as_json) as shown,
        ):
            found = fly_league(plan, folder, pool, progress=shown)
    except KeyboardInterrupt:
        line = f"interrupted; finished work is in {folder}, and the same command resumes from there"
        raise exit_with(line, ExitStatus.INTERRUPTED) from None
    with working(f"writing {output}", quiet=as_json):
        write_league_page(found, output)
    if as_json:
        print_json(found.to_dict())
        return
    show(render_league(found))
    print(f"page in {output}; tables of all flights in {folder}")
