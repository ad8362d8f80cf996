"""The command `gustproof campaign rare`: the probability of a rare event."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gustproof.cli.campaign.plan import (
    Draws,
    SamplingMethod,
    ScenarioName,
    SpreadKinds,
    Workers,
    describe_start,
    make_plan,
    open_pool,
)
from gustproof.cli.failures import ExitStatus, exit_with
from gustproof.cli.laws import choose_law, on_vehicle
from gustproof.cli.options import (
    COMPILING,
    SEED,
    Anyway,
    AsJson,
    Force,
    VehicleName,
    check_output,
    complete,
    flight_files,
    in_range,
    print_json,
    progress,
    save_flight,
)

if TYPE_CHECKING:
    from gustproof.studies.campaign.plan import Campaign
    from gustproof.studies.campaign.rare import Threshold


def rare(
    scenario: ScenarioName,
    event: Annotated[str, typer.Argument(help="A figure and its limit, such as 'peak_deg > 1'.", show_default=False)],
    law: Annotated[
        str | None,
        typer.Option(help="A law, as of `fly` [default: flagship].", autocompletion=complete("law")),
    ] = None,
    runs: Annotated[int, typer.Option(callback=in_range(1), help="Flights of each level.")] = 1000,
    workers: Workers = None,
    spread: SpreadKinds = None,
    sampling: SamplingMethod = "uniform",
    vehicle: VehicleName = "paper",
    seed: Annotated[int, SEED] = 1,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write the worst flight as a scenario here (.toml).")
    ] = None,
    anyway: Anyway = False,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Estimate the probability of an event in one flight that is too rare to be counted.

    It is reached level by level (subset simulation), by some 40 flights for each of --runs at a probability of 1e-6.
    Any figure of a campaign's table may be named; a flight that diverges is above any limit.

        gustproof campaign rare paper-turbulence "peak_deg > 1" --law flagship -o rare.toml
    """
    from firmware_model.config.scenario import load_scenario
    from firmware_model.config.uncertainty import load_vehicle_set
    from gustproof.studies.campaign.rare import parse_threshold

    threshold = parse_threshold(event)
    for path in flight_files(output) if output else ():
        check_output(path, ".toml", "a scenario file")
    vehicles = load_vehicle_set(vehicle)
    script = on_vehicle(load_scenario(scenario), vehicles.nominal)
    flown = choose_law(law, vehicles, script, quiet=as_json)
    plan = make_plan(script, (flown,), vehicles, Draws(runs, spread, sampling, seed), anyway=anyway)
    _estimate(plan, threshold, output, workers, (law or flown.name, vehicle), as_json=as_json)


def _estimate(
    plan: "Campaign",
    event: "Threshold",
    output: Path | None,
    workers: str | None,
    named: tuple[str, str],
    *,
    as_json: bool,
) -> None:
    """Print the probability of a rare event, with progress on standard error; write its worst flight.

    `named` are law and vehicle on the command line.
    """
    from gustproof.flight.routes.batch import is_cold
    from gustproof.show.report.campaign import render_rare
    from gustproof.show.report.terminal import show
    from gustproof.studies.campaign.rare import estimate_rare, make_rare_case

    title = f"{plan.scenario.name}, {event.text}"
    try:
        with (
            progress(describe_start(workers, title), quiet=as_json) as shown,
            open_pool(workers) as pool,
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
