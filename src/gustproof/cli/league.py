"""The command `gustproof league`: entries flown in the same seeds, and ranked."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.failures import ExitStatus, exit_with
from gustproof.cli.options import COMPILING, AsJson, check_output, print_json, progress, working


def league(
    output: Annotated[Path, typer.Option("-o", "--output", help="Write the page here (.html).")],
    entry: Annotated[
        list[str] | None,
        typer.Option(
            help="A law by name, NAME@PEAK, a law file, MODULE.py:MAKER or LIBRARY.so; {vehicle} in a file's name "
            "stands for the vehicle's. Repeat it [default: all, which are 19 laws and objects of the literature].",
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
    salt: Annotated[
        str | None, typer.Option(help="Derive hidden seeds from this text [default: public seeds].", show_default=False)
    ] = None,
    draw_salt: Annotated[
        bool, typer.Option("--draw-salt", help="Draw the salt, and keep it in the league's folder.")
    ] = False,
    reveal: Annotated[bool, typer.Option("--reveal", help="Publish the salt in page and JSON.")] = False,
    csv: Annotated[Path | None, typer.Option("--csv", help="Write the ranking here (.csv).")] = None,
    latex: Annotated[Path | None, typer.Option("--latex", help="Write the ranking here (.tex).")] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Worker processes [default: one for each core].", show_default=False)
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Fly entries in the same seeds, measure their prices, and rank them with confidence.

    Entries are laws tuned for each vehicle, law files, C libraries and Python objects. The score is the attitude error
    over that of `pid-fair`, over all scenarios and vehicles. Entries compete within price classes, whose bounds on Ms,
    margins and torque slew are measured by flights.

        gustproof league --entry flagship --entry pid-fair --entry my_mpc.py:make -o league.html

    The folder `league.work` beside the page keeps each result at once: the same command resumes, and one with more
    entries flies only those. The same salt gives the same bits.

    An organiser hides the seeds: the salt's SHA-256 is told before the first flight, and the salt after the last.

        gustproof league --draw-salt -o league.html && gustproof league --draw-salt --reveal -o league.html
    """
    from firmware_model.config.uncertainty import load_vehicle_set
    from gustproof.campaign.executors import count_cores, process_pool
    from gustproof.league.course import COURSE, FLEET, load_course
    from gustproof.league.entrants import ALL, parse_entrants
    from gustproof.league.season import LeaguePlan, fly_league
    from gustproof.recording.folder import write_atomic
    from gustproof.report.html.league_page import write_league_page
    from gustproof.report.league import render_league, write_csv, write_latex
    from gustproof.report.terminal import show
    from gustproof.simulate.batch import is_cold

    for path, suffix, kind in ((output, ".html", "a page"), (csv, ".csv", "a table"), (latex, ".tex", "a table")):
        check_output(path, suffix, kind)
    folder = output.with_suffix(".work")
    plan = LeaguePlan(
        entrants=parse_entrants(entry or [ALL]),
        vehicles=tuple(map(load_vehicle_set, vehicle or FLEET)),
        scenarios=tuple(load_course(scenario or COURSE)),
        runs=runs,
        salt=_choose_salt(salt, folder, draw=draw_salt),
    )
    _announce(plan.salt, folder, quiet=as_json)
    begun = COMPILING * any(map(is_cold, plan.scenarios))
    try:
        with (
            process_pool(workers or count_cores()) as pool,
            progress(f"{len(plan.entrants)} entries{begun}", quiet=as_json) as shown,
        ):
            found = fly_league(plan, folder, pool, progress=shown)
    except KeyboardInterrupt:
        line = f"interrupted; finished results are in {folder}, and the same command resumes from there"
        raise exit_with(line, ExitStatus.INTERRUPTED) from None
    with working(f"writing {output}", quiet=as_json):
        write_league_page(found, output, reveal=reveal)
    if csv is not None:
        write_atomic(csv, write_csv(found))
    if latex is not None:
        write_atomic(latex, write_latex(found))
    if as_json:
        print_json(found.to_dict(reveal=reveal))
        return
    show(render_league(found))
    print(f"page in {output}; results in {folder}")


def _choose_salt(salt: str | None, folder: Path, *, draw: bool) -> str:
    """Return the given salt, the one that is drawn and kept in the league's folder, or the public one."""
    from gustproof.league.salt import PUBLIC_SALT, check_salt, keep_salt

    if salt is not None and draw:
        raise ConfigError("--salt and --draw-salt: give one of them")
    if salt is not None:
        return check_salt(salt)
    return keep_salt(folder) if draw else PUBLIC_SALT


def _announce(salt: str, folder: Path, *, quiet: bool) -> None:
    """Tell and store the commitment before the first flight."""
    from gustproof.league.salt import PUBLIC_SALT, commit, store_commitment

    store_commitment(folder, salt)
    if not quiet:
        told = "seeds are public" if salt == PUBLIC_SALT else f"SHA-256 of the salt: {commit(salt)}"
        print(f"gustproof: {told}", file=sys.stderr)
