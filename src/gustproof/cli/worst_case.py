"""The command `gustproof worst-case`: the most harmful disturbance."""

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.laws import LAW_HELP, find_law
from gustproof.cli.options import AsJson, VehicleName, check_output, parse_positive_vector, print_json, progress

if TYPE_CHECKING:
    from gustproof.falsify.worst_case import WorstCase


def worst_case(
    law: Annotated[str, typer.Argument(help=LAW_HELP)],
    budget: Annotated[
        str, typer.Option("--moment", help="Largest moment about each axis, L,M,N [N m].")
    ] = "0.65,0.65,0.3",
    horizon: Annotated[float, typer.Option(min=1.0, max=3600.0, help="Length of a flight [s].")] = 60.0,
    inertia_spread: Annotated[
        float, typer.Option(min=0.0, max=0.9, help="Search inertias within this fraction of their nominal values.")
    ] = 0.0,
    lag_spread: Annotated[
        float, typer.Option(min=0.0, max=0.9, help="Search the actuator lag within this fraction of its nominal value.")
    ] = 0.0,
    vehicle: VehicleName = "paper",
    flights: Annotated[int, typer.Option(min=100, help="Flights of the search.")] = 500,
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="Seed of the search.")] = 1,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write the worst flight as a scenario here (.toml).")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Search a moment budget for the disturbance with the largest attitude error in the nonlinear simulation.

    The search covers sines, square waves, held moments and turbulence. It starts from the weak directions of the
    linear loop and at random. The result is a lower bound: the true worst case is at least as bad. For an upper
    bound see `gustproof certify`.

        gustproof worst-case hinf-d1 -o worst.toml && gustproof fly worst.toml --law hinf-d1

        gustproof worst-case hinf-scheduled --inertia-spread 0.2 --lag-spread 0.3 --json
    """
    from pydantic_core import to_jsonable_python

    from firmware_model.config.files import write_toml
    from firmware_model.config.vehicle import load_vehicle
    from gustproof.falsify.worst_case import worst_case as search
    from gustproof.model.uncertainty import Spreads
    from gustproof.simulate.flight import warnings

    moment = parse_positive_vector("--moment", budget)
    check_output(output, ".toml", "a scenario file")
    airframe = load_vehicle(vehicle)
    flown = find_law(law, airframe, None)
    title = f"searching, {flown.name}"
    try:
        with progress(title, quiet=as_json) as shown:
            spreads = Spreads(inertia=inertia_spread, actuator_lag=lag_spread)
            found = search(
                flown,
                vehicle=airframe,
                budget=moment,
                duration_s=horizon,
                flights=flights,
                seed=seed,
                spreads=spreads,
                progress=lambda share: shown(share, title),
            )
    except ValueError as error:
        raise ConfigError(str(error)) from None
    known = warnings(found.scenario, flown, airframe)
    files = [] if output is None else [output]
    if output is not None:
        write_toml(found.scenario, output)
        if found.vehicle != airframe:
            files.append(output.with_name(f"{output.stem}-vehicle.toml"))
            write_toml(found.vehicle, files[1])
    if as_json:
        document = {
            "law": flown.name,
            "moment_nm": moment,
            "warnings": known,
            "files": files,
            **to_jsonable_python(found),
        }
        print_json(to_jsonable_python(document, inf_nan_mode="null"))
        return
    for line in known:
        print(f"gustproof: warning: {line}", file=sys.stderr)
    _print(flown.name, found, horizon)
    if files:
        other = f" --vehicle {files[1] if files[1:] else vehicle}" if files[1:] or vehicle != "paper" else ""
        print(f"fly it: gustproof fly {output} --law {law}{other} --seed {found.seed}")


def _print(law: str, found: "WorstCase", horizon: float) -> None:
    if math.isinf(found.peak_deg):
        print(f"{law}: diverges within {horizon:g} s; found in {found.flights} flights, from: {found.start}")
    else:
        phi, theta, psi = found.peaks_deg
        peaks = f"phi {phi:.2f}, theta {theta:.2f}, psi {psi:.2f}"
        print(f"{law}: {found.peak_deg:.2f} deg ({peaks}) in {horizon:g} s")
        print(f"found in {found.flights} flights, from: {found.start} ({found.start_deg:.2f} deg there)")
        print(f"linear theory for the nominal vehicle predicts at most {found.linear_deg:.2f} deg in the budget")
