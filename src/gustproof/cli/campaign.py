"""The command `gustproof campaign`: one scenario, flown many times."""

import sys
from collections.abc import Iterable
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.failures import ExitStatus, exit_with
from gustproof.cli.laws import LAW_HELP, default_law, find_law
from gustproof.cli.options import (
    Anyway,
    AsJson,
    AutopilotName,
    Build,
    Params,
    VehicleName,
    check_output,
    print_json,
    progress,
)

if TYPE_CHECKING:
    from gustproof.campaign.plan import Campaign
    from gustproof.entries.entry import Entry

Choice = TypeVar("Choice", bound=Enum)


def campaign(
    scenario: Annotated[str, typer.Argument(help="Name of a shipped scenario, or a .toml file.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Write the table here (.parquet).")],
    law: Annotated[
        list[str] | None,
        typer.Option(
            help=f"{LAW_HELP} Repeat it to compare laws case by case [default: flagship, tuned for your vehicle]."
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

    A controller of your own may fly beside the laws: an object of Python one run at a time, C as fast as a law.

        gustproof campaign paper --law flagship --controller my_mpc.py:make --controller ./law.so -o all.parquet

    A real autopilot may fly beside the laws, some seconds a run:

        gustproof campaign paper-turbulence --autopilot px4 --params tuned --runs 20 -o px4.parquet
    """
    from firmware_model.config.scenario import load_scenario
    from firmware_model.config.uncertainty import load_vehicle_set
    from gustproof.campaign.plan import Campaign, Contestant, DispersionKind, select_spreads, usual_dispersions
    from gustproof.campaign.sampling import Sampling
    from gustproof.campaign.statistics import compute_statistics
    from gustproof.report.campaign import render_campaign
    from gustproof.report.terminal import show
    from gustproof.simulate.flight import check
    from gustproof.simulate.guest import ForeignAutopilot, check_guest

    script, vehicles = load_scenario(scenario), load_vehicle_set(vehicle)
    if spread is None:
        wanted = usual_dispersions(vehicles)
    else:
        wanted = [_parse_choice(DispersionKind, "--spread", word.strip()) for word in spread.split(",")]
    laws = [find_law(name, vehicles.nominal, script.control_rate_hz) for name in law or ()]
    contestants: list[Contestant] = [*laws, *_find_entries(controller or ())]
    if autopilot is not None:
        contestants.append(ForeignAutopilot(kind=autopilot, build=build, parameters=params))
        check_guest(script)
    if not contestants:
        laws = [default_law(vehicles, script, quiet=as_json)]
        contestants = [*laws]
    plan = Campaign(
        scenario=script,
        laws=tuple(contestants),
        vehicles=vehicles,
        spreads=select_spreads(vehicles, script, wanted, gust=gust_spread, attitude_deg=attitude_spread),
        cases=runs,
        sampling=_parse_choice(Sampling, "--sampling", sampling),
        seed=seed,
    )
    if not anyway:
        for flown in laws:
            check(plan.scenario, flown, plan.vehicles.nominal)
    _fly(plan, output, workers, executor, quiet=as_json)
    found = compute_statistics(output)
    if as_json:
        print_json(found.to_dict())
    else:
        show(render_campaign(found))


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
    from gustproof.campaign.reader import read_campaign_metadata
    from gustproof.campaign.runner import fly_campaign
    from gustproof.campaign.store import check_same_campaign

    check_output(output, ".parquet", "a campaign's table")
    if output.exists():
        check_same_campaign(read_campaign_metadata(output), plan.metadata(), f"{output}: holds another campaign")
        _print_status(f"{output}: all {plan.runs:,} runs are there", quiet=quiet)
        return
    if plan.scenario.has_link_script:
        why = f"{plan.scenario.name} has link, mode or controller events"
        _print_status(f"{why}, so each run goes over UDP (about 1 s a run instead of 5 ms)", quiet=quiet)
    title = f"{plan.scenario.name}, {', '.join(law.name for law in plan.laws)}"
    try:
        with (
            dask_pool(executor) if executor else process_pool(workers or count_cores()) as pool,
            progress(title, quiet=quiet) as shown,
        ):
            fly_campaign(
                plan,
                output,
                pool,
                progress=lambda flown, of: shown(flown / max(of, 1), f"{title}: {plan.runs - of + flown:,} runs"),
            )
    except KeyboardInterrupt:
        line = f"interrupted; finished runs are in {output}.parts, and the same command resumes from there"
        raise exit_with(line, ExitStatus.INTERRUPTED) from None


def _print_status(line: str, *, quiet: bool) -> None:
    if not quiet:
        print(f"gustproof: {line}", file=sys.stderr)


def _parse_choice(kind: type[Choice], option: str, word: str) -> Choice:
    try:
        return kind(word)
    except ValueError:
        raise ConfigError(f"{option}: '{word}' is none of {', '.join(choice.value for choice in kind)}") from None
