"""The command `gustproof campaign fly`: one scenario, flown many times."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.campaign.plan import (
    Draws,
    SamplingMethod,
    ScenarioName,
    SpreadKinds,
    Workers,
    describe_start,
    make_plan,
    open_pool,
    print_status,
)
from gustproof.cli.failures import ExitStatus, exit_with
from gustproof.cli.flights import tell_rate
from gustproof.cli.laws import default_law, find_law, on_vehicle, warn_of_repeated
from gustproof.cli.options import (
    COMPILING,
    SEED,
    Anyway,
    AsJson,
    AutopilotName,
    Build,
    Force,
    Params,
    VehicleName,
    check_output,
    complete,
    in_range,
    print_json,
    print_next,
    progress,
    working,
)

if TYPE_CHECKING:
    from firmware_model.config.scenario import Scenario
    from firmware_model.config.uncertainty import VehicleSet
    from gustproof.flight.controllers.external_autopilot import AnyController
    from gustproof.flight.controllers.user_controller import UserController
    from gustproof.studies.campaign.plan import Campaign
    from gustproof.studies.campaign.statistics import CampaignStatistics
    from gustproof.studies.campaign.store import Shard

_FIGURES = (".csv", ".tex", ".xml")


def fly(
    scenario: ScenarioName,
    output: Annotated[
        list[Path],
        typer.Option("-o", "--output", help="Write the table here (.parquet), figures (.csv, .tex), JUnit (.xml)."),
    ],
    law: Annotated[
        list[str] | None,
        typer.Option(help="A law, as of `fly`; repeat it [default: flagship].", autocompletion=complete("law")),
    ] = None,
    controller: Annotated[
        list[str] | None,
        typer.Option(help="FILE.py:MAKER or LIBRARY.so of your own; repeat it.", show_default=False),
    ] = None,
    autopilot: AutopilotName = None,
    build: Build = "",
    params: Params = "",
    runs: Annotated[int, typer.Option(callback=in_range(1, 10**8), help="Flights of each law.")] = 1000,
    workers: Workers = None,
    spread: SpreadKinds = None,
    sampling: SamplingMethod = "uniform",
    shard: Annotated[str | None, typer.Option(help="Fly one part alone, such as 2/8.", show_default=False)] = None,
    vehicle: VehicleName = "paper",
    seed: Annotated[int, SEED] = 1,
    anyway: Anyway = False,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Fly one scenario many times with varied parameters, and print statistics with confidence intervals.

    Each flight has gusts and noise of its own, the same for every law. The table has a row for each run; it does not
    depend on workers or interruptions. The same command resumes it; more --runs, or another --law, extend it. With
    --shard it leaves rows beside the table, as other machines do; the same command without it puts them together.

        gustproof campaign fly paper --law hinf-scheduled --law pid-fair -o mc.parquet
        gustproof campaign fly paper-turbulence --autopilot px4 --runs 20 -o px4.parquet
    """
    from firmware_model.config.scenario import load_scenario
    from firmware_model.config.uncertainty import load_vehicle_set
    from gustproof.show.report.campaign import render_campaign
    from gustproof.show.report.terminal import show
    from gustproof.studies.campaign.statistics import compute_statistics

    table, figures = _split_outputs(output)
    vehicles = load_vehicle_set(vehicle)
    script = on_vehicle(load_scenario(scenario), vehicles.nominal)
    controllers = _find_controllers(law or (), controller or (), autopilot, build, params, vehicles, script)
    if not controllers:
        controllers = _default_controllers(table if table.exists() else None, vehicles, script, quiet=as_json)
    plan = make_plan(script, controllers, vehicles, Draws(runs, spread, sampling, seed), anyway=anyway)
    if shard is not None:
        _fly_shard(plan, table, workers, shard, as_json=as_json)
        return
    _fly(plan, table, workers, quiet=as_json)
    with working(f"statistics of {table}", quiet=as_json):
        found = compute_statistics(table)
    _save_figures(found, figures)
    if as_json:
        print_json(found.to_dict())
        return
    show(render_campaign(found))
    print_next("report", table, "-o", table.with_suffix(".html"))


def _find_controllers(
    laws: Sequence[str],
    controllers: Sequence[str],
    autopilot: str | None,
    build: str,
    params: str,
    vehicles: "VehicleSet",
    script: "Scenario",
) -> "tuple[AnyController, ...]":
    from gustproof.flight.controllers.external_autopilot import ExternalAutopilot
    from gustproof.flight.routes.external import check_external

    found: tuple[AnyController, ...] = (
        *(find_law(name, vehicles.nominal, script.control_rate_hz) for name in laws),
        *_find_entries(controllers),
    )
    if autopilot is None:
        return found
    warn_of_repeated([params], autopilot)
    flown = ExternalAutopilot(kind=autopilot, build=build, parameters=params)
    check_external(script, autopilot)
    tell_rate(script, autopilot)
    return (*found, flown)


def _default_controllers(
    table: Path | None, vehicles: "VehicleSet", script: "Scenario", *, quiet: bool
) -> "tuple[AnyController, ...]":
    """Return the laws of a table that grows, else the default law."""
    from gustproof.studies.campaign.reader import read_campaign

    return (default_law(vehicles, script, quiet=quiet),) if table is None else read_campaign(table).laws


def _split_outputs(output: Sequence[Path]) -> tuple[Path, list[Path]]:
    """Return the table and the files of figures; refuse files that the command can't write."""
    figures = [path for path in output if path.suffix in _FIGURES]
    tables = [path for path in output if path not in figures]
    if len(tables) != 1:
        raise ConfigError(f"-o: {'two tables' if tables else 'no table (.parquet)'} of one campaign")
    if not tables[0].exists():  # a table grows, and is never overwritten
        check_output(tables[0], ".parquet", "a campaign's table")
    for path in figures:
        check_output(path, _FIGURES, "a file of figures")
    return tables[0], figures


def _save_figures(found: "CampaignStatistics", figures: Iterable[Path]) -> None:
    from gustproof.show.report.summary_files import save_csv, save_junit, save_latex

    for path in figures:
        {".csv": save_csv, ".tex": save_latex, ".xml": save_junit}[path.suffix](found, path)


def _find_entries(sources: Iterable[str]) -> "list[UserController]":
    """Return controllers that can fly in the processes of a campaign."""
    from gustproof.flight.controllers.user_controller import ControllerKind, parse_controller

    entries = list(map(parse_controller, sources))
    for entry in entries:
        if entry.kind is ControllerKind.PROGRAM:
            raise ConfigError(f"controller '{entry.source}': a program flies one flight at a time, by gustproof fly")
    return entries


def _fly_shard(plan: "Campaign", output: Path, workers: str | None, text: str, *, as_json: bool) -> None:
    """Fly one part of a new campaign, and say how the parts become a table."""
    from gustproof.studies.campaign.store import Shard, parts_folder

    number, slash, count = text.partition("/")
    if not (slash and number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count) <= plan.cases):
        raise ConfigError(f"--shard: is '{text}', must be I/N such as 2/8, I from 1 to N, N at most the --runs")
    if as_json:
        raise ConfigError("--json: a shard has no figures; the same command without --shard has")
    if output.exists():
        raise ConfigError(f"{output}: exists already; a shard flies for a new table")
    _fly(plan, output, workers, quiet=False, shard=Shard(int(number), int(count)))
    then = f"once all are there, the same command without --shard writes {output}"
    print(f"shard {text} is in {parts_folder(output)}; {then}")


def _fly(plan: "Campaign", output: Path, workers: str | None, *, quiet: bool, shard: "Shard | None" = None) -> None:
    """Fly the missing runs, with progress on standard error."""
    from gustproof.flight.routes.batch import is_cold
    from gustproof.studies.campaign.growth import resume_campaign
    from gustproof.studies.campaign.runner import fly_campaign

    plan, known_runs = resume_campaign(output, plan)
    if known_runs == plan.runs:
        print_status(f"{output}: all {plan.runs:,} runs are there", quiet=quiet)
        return
    if known_runs:
        print_status(f"{output}: {known_runs:,} of {plan.runs:,} runs are there", quiet=quiet)
    if plan.scenario.needs_messages:
        why = f"{plan.scenario.name} kills the controller or sets modes"
        print_status(f"{why}, so each run is flown with messages, some fifty times as long", quiet=quiet)
    title, runs = f"{plan.scenario.name}, {', '.join(law.name for law in plan.laws)}", plan.runs if shard is None else 0
    begun = COMPILING * is_cold(plan.scenario)

    def describe(flown: int) -> str:
        return f"{title}: {flown:,} runs" if flown or not begun else f"{title}{begun}"

    try:
        with (
            progress(describe_start(workers, title), quiet=quiet) as shown,
            open_pool(workers) as pool,
        ):
            fly_campaign(
                plan,
                output,
                pool,
                progress=lambda flown, of: shown(flown / max(of, 1), describe((runs or of) - of + flown)),
                known=output if known_runs else None,
                shard=shard,
            )
    except KeyboardInterrupt:
        raise exit_with(f"interrupted; {_describe_kept(output)}", ExitStatus.INTERRUPTED) from None


def _describe_kept(output: Path) -> str:
    from gustproof.studies.campaign.store import parts_folder

    parts = parts_folder(output)
    if not any(parts.glob("*.arrow")):
        return "no run was finished"
    return f"finished runs are in {parts}, and the same command resumes from there"
