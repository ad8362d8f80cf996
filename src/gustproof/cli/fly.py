"""`gustproof fly`: one flight."""

import json
from pathlib import Path
from typing import Annotated

import typer

from gustproof.cli.failures import Status, stop
from gustproof.cli.progress import progress


def fly(
    scenario: Annotated[str, typer.Argument(help="Name of a shipped scenario, or a .toml file.")],
    law: Annotated[str, typer.Option(help="Name of a shipped law, or a .json file.")],
    vehicle: Annotated[str, typer.Option(help="Name of a shipped vehicle, or a .toml file.")] = "paper",
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="Seed of gusts and noise.")] = 1,
    real_time: Annotated[
        bool, typer.Option("--real-time", help="At the pace of the clock, on the usual ports.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help="New folder for the recording [default: a fresh one in runs/].")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON on stdout, and nothing else.")] = False,
) -> None:
    """Fly one scenario: autopilot and controller as two processes that speak MAVLink over UDP.

    Leaves a rosbag2 bag (MCAP) in the output folder and prints the flight's figures.

        gustproof fly paper --law hinf-d1

        gustproof fly paper-turbulence --law my-law.json --seed 7 --json
    """
    from firmware_model.scenario import load_scenario
    from firmware_model.vehicle import load_vehicle
    from gustproof.flight import fly_and_record
    from gustproof.law import load_law
    from gustproof.recording.folder import fresh_folder
    from gustproof.report.document import flight_document, show
    from gustproof.sitl import Outcome

    script, airframe, flown = load_scenario(scenario), load_vehicle(vehicle), load_law(law)
    folder = fresh_folder(out, "fly")
    with progress(f"{script.name}, {flown.name}", quiet=as_json) as shown:
        result = fly_and_record(
            script, flown, vehicle=airframe, seed=seed, out=folder, real_time=real_time,
            progress=lambda fraction: shown(fraction, f"{script.name}, {flown.name}"),
        )  # fmt: skip
    if as_json:
        print(json.dumps(result.document(), indent=2))
    else:
        show(flight_document(result.message, result.metrics, result.bag))
    if result.outcome is Outcome.INTERRUPTED:
        raise stop(f"interrupted; what was flown is in {folder}", Status.INTERRUPTED)
    if result.outcome is not Outcome.DONE:
        raise stop(f"{result.message}; what was flown is in {folder}", Status.FLIGHT_BROKE_OFF)
