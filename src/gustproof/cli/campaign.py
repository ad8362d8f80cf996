"""The command `gustproof campaign`: one scenario, flown many times."""

import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from firmware_model.config.validation import none_of
from firmware_model.errors import ConfigError
from gustproof.cli.failures import ExitStatus, exit_with
from gustproof.cli.laws import LAW_HELP, default_law, find_law
from gustproof.cli.options import (
    COMPILING,
    Anyway,
    AsJson,
    AutopilotName,
    Build,
    Params,
    VehicleName,
    check_output,
    complete,
    print_json,
    progress,
    save_flight,
    working,
)

if TYPE_CHECKING:
    from firmware_model.config.scenario import Scenario
    from firmware_model.config.uncertainty import VehicleSet
    from gustproof.campaign.plan import Campaign, Contestant, DispersionKind
    from gustproof.campaign.rare import Threshold
    from gustproof.campaign.statistics import CampaignStatistics
    from gustproof.entries.entry import Entry

Choice = TypeVar("Choice", bound=Enum)


def campaign(
    scenario: Annotated[
        str, typer.Argument(help="Name of a shipped scenario, or a .toml file.", autocompletion=complete("scenario"))
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="Write the table here (.parquet); with --rare, the worst flight as a scenario (.toml).",
            show_default=False,
        ),
    ] = None,
    law: Annotated[
        list[str] | None,
        typer.Option(
            help=f"{LAW_HELP} Repeat it to compare laws case by case [default: flagship, tuned for your vehicle].",
            autocompletion=complete("law"),
        ),
    ] = None,
    controller: Annotated[
        list[str] | None,
        typer.Option(
            help="Fly a controller of your own beside the laws: FILE.py:MAKER or LIBRARY.so. Repeat it for more.",
            show_default=False,
        ),
    ] = None,
    autopilot: AutopilotName = None,
    build: Build = "",
    params: Params = "",
    runs: Annotated[int, typer.Option(min=1, help="Flights of each law.")] = 1000,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Worker processes [default: one for each core].", show_default=False)
    ] = None,
    spread: Annotated[
        str | None,
        typer.Option(help="Quantities to vary: vehicle, gust, gyro, attitude [default: gust, and the file's spreads]."),
    ] = None,
    sampling: Annotated[str, typer.Option(help="Sampling method: uniform, normal, latin or sobol.")] = "uniform",
    gust_spread: Annotated[
        float, typer.Option(min=0.01, max=1.0, help="Scale the gusts by 1 - this to 1 + this.")
    ] = 0.5,
    attitude_spread: Annotated[
        float, typer.Option(min=0.01, max=60.0, help="Start within this angle of the scenario's attitude [deg].")
    ] = 5.0,
    vehicle: VehicleName = "paper",
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="Seed of all random draws.")] = 1,
    executor: Annotated[
        str | None, typer.Option(help="Fly on a dask cluster: dask://tcp://HOST:PORT.", show_default=False)
    ] = None,
    rare: Annotated[
        str | None,
        typer.Option(
            metavar="'FIGURE > LIMIT'",
            help="Estimate the probability of a rare event in one flight instead, such as 'peak_deg > 1'.",
            show_default=False,
        ),
    ] = None,
    latex: Annotated[
        Path | None, typer.Option(help="Write figures with intervals as a LaTeX table here (.tex).", show_default=False)
    ] = None,
    csv: Annotated[
        Path | None, typer.Option(help="Write all figures with intervals here (.csv).", show_default=False)
    ] = None,
    anyway: Anyway = False,
    as_json: AsJson = False,
) -> None:
    """Fly one scenario many times with varied parameters, and print statistics with confidence intervals.

    The vehicle file holds the spreads of vehicle and gyro. Each flight has gusts and noise of its own, the same for
    every law. The result is one Parquet table with a row for each run. The same command resumes an interrupted
    campaign. The table does not depend on workers, executor or interruptions. A failed requirement is a result, not
    an error.

        gustproof campaign paper --law hinf-scheduled --law pid-fair --runs 1000 -o mc.parquet

        gustproof report mc.parquet -o mc.html

        gustproof fly --run mc.parquet:471

    With more --runs, or another --law, the same command extends the table: what is flown is not flown again.

    A controller of your own may fly beside the laws: an object of Python one run at a time, C as fast as a law.

        gustproof campaign paper --law flagship --controller my_mpc.py:make --controller ./law.so -o all.parquet

    A real autopilot may fly beside the laws, some seconds a run:

        gustproof campaign paper-turbulence --autopilot px4 --params tuned --runs 20 -o px4.parquet

    An event too rare to be counted is reached level by level (subset simulation), by some 40 flights for each of
    --runs at a probability of 1e-6. Any figure of the table may be named; a flight that diverges is above any limit:

        gustproof campaign paper-turbulence --law flagship --rare "peak_deg > 1" -o rare.toml
    """
    from firmware_model.config.scenario import load_scenario
    from firmware_model.config.uncertainty import load_vehicle_set
    from gustproof.campaign.plan import Campaign, select_spreads
    from gustproof.campaign.rare import parse_threshold
    from gustproof.campaign.sampling import Sampling
    from gustproof.campaign.statistics import compute_statistics
    from gustproof.report.campaign import render_campaign
    from gustproof.report.terminal import show

    event = None if rare is None else parse_threshold(rare)
    _check_outputs(output, latex, csv, is_rare=event is not None)
    script, vehicles = load_scenario(scenario), load_vehicle_set(vehicle)
    contestants = _find_contestants(law or (), controller or (), autopilot, build, params, vehicles, script)
    table = None if output is None or event is not None or not output.exists() else output
    if not contestants:
        contestants = _default_contestants(table, vehicles, script, quiet=as_json)
    plan = Campaign(
        scenario=script,
        laws=contestants,
        vehicles=vehicles,
        spreads=select_spreads(
            vehicles, script, _parse_dispersions(spread, vehicles), gust=gust_spread, attitude_deg=attitude_spread
        ),
        cases=runs,
        sampling=_parse_choice(Sampling, "--sampling", sampling),
        seed=seed,
    )
    if not anyway:
        _check_laws(plan)
    if event is not None:
        named = (law[0] if law else plan.laws[0].name, vehicle)
        _estimate_rare(plan, event, output, workers, executor, named, as_json=as_json)
        return
    assert output is not None  # see _check_outputs
    _fly(plan, output, workers, executor, quiet=as_json)
    with working(f"statistics of {output}", quiet=as_json):
        found = compute_statistics(output)
    _save_figures(found, csv, latex)
    if as_json:
        print_json(found.to_dict())
    else:
        show(render_campaign(found))


def _find_contestants(
    laws: Sequence[str],
    controllers: Sequence[str],
    autopilot: str | None,
    build: str,
    params: str,
    vehicles: "VehicleSet",
    script: "Scenario",
) -> "tuple[Contestant, ...]":
    from gustproof.simulate.guest import ForeignAutopilot, check_guest

    found: tuple[Contestant, ...] = (
        *(find_law(name, vehicles.nominal, script.control_rate_hz) for name in laws),
        *_find_entries(controllers),
    )
    if autopilot is None:
        return found
    check_guest(script)
    return (*found, ForeignAutopilot(kind=autopilot, build=build, parameters=params))


def _default_contestants(
    table: Path | None, vehicles: "VehicleSet", script: "Scenario", *, quiet: bool
) -> "tuple[Contestant, ...]":
    """Return the laws of a table that grows, else the default law."""
    from gustproof.campaign.reader import read_campaign

    return (default_law(vehicles, script, quiet=quiet),) if table is None else read_campaign(table).laws


def _parse_dispersions(words: str | None, vehicles: "VehicleSet") -> "list[DispersionKind]":
    """Return the kinds of dispersions that are asked for, by default those of the vehicle's file."""
    from gustproof.campaign.plan import DispersionKind, usual_dispersions

    if words is None:
        return usual_dispersions(vehicles)
    return [_parse_choice(DispersionKind, "--spread", word.strip()) for word in words.split(",")]


def _check_laws(plan: "Campaign") -> None:
    """Refuse a law that can't fly the nominal vehicle."""
    from gustproof.law.form import Law
    from gustproof.simulate.flight import check

    for law in plan.laws:
        if isinstance(law, Law):
            check(plan.scenario, law, plan.vehicles.nominal)


def _save_figures(found: "CampaignStatistics", csv: Path | None, latex: Path | None) -> None:
    from gustproof.report.summary_files import save_csv, save_latex

    if csv is not None:
        save_csv(found, csv)
    if latex is not None:
        save_latex(found, latex)


def _check_outputs(output: Path | None, latex: Path | None, csv: Path | None, *, is_rare: bool) -> None:
    """Refuse files that the command can't write.

    Raises
    ------
    ConfigError
        If one of them is wrong, or none is given for the table.
    """
    if is_rare:
        check_output(output, ".toml", "a scenario file")
        if latex is not None or csv is not None:
            raise ConfigError("--rare: flies no table, so --latex and --csv have nothing to show")
        return
    if output is None:
        raise ConfigError("give -o, the file for the table (.parquet)")
    check_output(output, ".parquet", "a campaign's table")
    check_output(latex, ".tex", "a LaTeX table")
    check_output(csv, ".csv", "a table of figures")


def _find_entries(sources: Iterable[str]) -> "list[Entry]":
    """Return controllers that can fly in the processes of a campaign."""
    from gustproof.entries.entry import EntryKind, parse_entry

    entries = list(map(parse_entry, sources))
    for entry in entries:
        if entry.kind is EntryKind.PROGRAM:
            raise ConfigError(f"controller '{entry.source}': a program flies one flight at a time, by gustproof fly")
    return entries


def _fly(plan: "Campaign", output: Path, workers: int | None, executor: str | None, *, quiet: bool) -> None:
    """Fly the missing runs, with progress on standard error."""
    from gustproof.campaign.executors import count_cores, dask_pool, process_pool
    from gustproof.campaign.growth import grow_campaign
    from gustproof.campaign.reader import read_campaign
    from gustproof.campaign.runner import fly_campaign
    from gustproof.simulate.batch import is_cold

    known = output if output.exists() else None
    if known is not None:
        flown, plan = read_campaign(known).runs, grow_campaign(known, plan)
        if flown == plan.runs:
            _print_status(f"{output}: all {plan.runs:,} runs are there", quiet=quiet)
            return
        _print_status(f"{output}: {flown:,} of {plan.runs:,} runs are there", quiet=quiet)
    if plan.scenario.has_link_script:
        why = f"{plan.scenario.name} has link, mode or controller events"
        _print_status(f"{why}, so each run goes over UDP (about 1 s a run instead of 5 ms)", quiet=quiet)
    title = f"{plan.scenario.name}, {', '.join(law.name for law in plan.laws)}"
    begun = COMPILING * is_cold(plan.scenario)

    def describe(flown: int) -> str:
        return f"{title}: {flown:,} runs" if flown or not begun else f"{title}{begun}"

    try:
        with (
            progress(_start(executor, title), quiet=quiet) as shown,
            dask_pool(executor) if executor else process_pool(workers or count_cores()) as pool,
        ):
            fly_campaign(
                plan,
                output,
                pool,
                progress=lambda flown, of: shown(flown / max(of, 1), describe(plan.runs - of + flown)),
                known=known,
            )
    except KeyboardInterrupt:
        raise exit_with(f"interrupted; {_describe_kept(output)}", ExitStatus.INTERRUPTED) from None


def _describe_kept(output: Path) -> str:
    from gustproof.campaign.store import parts_folder

    parts = parts_folder(output)
    if not any(parts.glob("*.arrow")):
        return "no run was finished"
    return f"finished runs are in {parts}, and the same command resumes from there"


def _start(executor: str | None, title: str) -> str:
    """Return what is done before the first run."""
    return f"connecting to {executor}, {title}" if executor else f"starting workers, {title}"


def _estimate_rare(
    plan: "Campaign",
    event: "Threshold",
    output: Path | None,
    workers: int | None,
    executor: str | None,
    named: tuple[str, str],
    *,
    as_json: bool,
) -> None:
    """Print the probability of a rare event, with progress on standard error; write its worst flight.

    `named` are law and vehicle on the command line.
    """
    from gustproof.campaign.executors import count_cores, dask_pool, process_pool
    from gustproof.campaign.rare import estimate_rare, make_rare_case
    from gustproof.report.campaign import render_rare
    from gustproof.report.terminal import show
    from gustproof.simulate.batch import is_cold

    title = f"{plan.scenario.name}, {event.text}"
    try:
        with (
            progress(_start(executor, title), quiet=as_json) as shown,
            dask_pool(executor) if executor else process_pool(workers or count_cores()) as pool,
        ):
            begun = COMPILING * is_cold(plan.scenario)
            found = estimate_rare(
                plan, event, pool, progress=lambda share: shown(share, title if share else title + begun)
            )
    except KeyboardInterrupt:
        raise exit_with("interrupted; nothing is kept", ExitStatus.INTERRUPTED) from None
    files, line = [], ""
    if output is not None and found.hits:
        worst = found.hits[0]
        case = make_rare_case(plan, worst.seed, worst.turns, worst.deltas)
        flown = replace(case.apply_to(plan.scenario), name=output.stem)
        files = save_flight(flown, case.vehicle, plan.vehicles.nominal, output)
        airframe = files[1] if files[1:] else named[1]
        line = f"fly it: gustproof fly {files[0]} --law {named[0]} --vehicle {airframe} --seed {worst.seed}"
    if as_json:
        print_json({**found.to_dict(), "runs": plan.cases, "seed": plan.seed, "files": [str(path) for path in files]})
        return
    show(render_rare(found, plan))
    if line:
        print(line)


def _print_status(line: str, *, quiet: bool) -> None:
    if not quiet:
        print(f"gustproof: {line}", file=sys.stderr)


def _parse_choice(kind: type[Choice], option: str, word: str) -> Choice:
    try:
        return kind(word)
    except ValueError:
        raise ConfigError(f"{option}: {none_of(word, [choice.value for choice in kind])}") from None
