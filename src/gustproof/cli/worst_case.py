"""The command `gustproof worst-case`: the most harmful disturbance."""

import math
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.laws import FLOWN_HELP, find_controller, is_user_controller
from gustproof.cli.options import (
    AsJson,
    Force,
    VehicleName,
    check_output,
    complete,
    flight_files,
    in_range,
    parse_positive_vector,
    print_json,
    progress,
    save_flight,
)

if TYPE_CHECKING:
    from firmware_model.config.vehicle import Vehicle
    from gustproof.flight.controllers.user_controller import Controller
    from gustproof.studies.worst_case.moment_search import WorstCase
    from gustproof.studies.worst_case.shrink import SmallestCase

_TURNED_OVER_DEG = 90.0
_SHARE = 0.9  # [-] of the worst error, that a shrunk flight reaches by default


def worst_case(
    law: Annotated[str, typer.Argument(help=FLOWN_HELP, show_default=False, autocompletion=complete("law"))],
    budget: Annotated[
        str, typer.Option("--moment", help="Largest moment about each axis, L,M,N [N m].")
    ] = "0.65,0.65,0.3",
    horizon: Annotated[float, typer.Option(callback=in_range(1, 3600), help="Length of a flight [s].")] = 60.0,
    inertia_spread: Annotated[
        float, typer.Option(callback=in_range(0, 0.9), help="Search inertias within this fraction of nominal.")
    ] = 0.0,
    lag_spread: Annotated[
        float, typer.Option(callback=in_range(0, 0.9), help="Search the actuator lag within this fraction of nominal.")
    ] = 0.0,
    vehicle: VehicleName = "paper",
    flights: Annotated[int, typer.Option(callback=in_range(100), help="Flights of the search.")] = 500,
    seed: Annotated[int, typer.Option(callback=in_range(0, 2**32 - 1), help="Seed of the search.")] = 1,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write the worst flight as a scenario here (.toml).")
    ] = None,
    shrink: Annotated[
        bool,
        typer.Option("--shrink", help=f"Shrink it to the least that still gives {_SHARE:g} of the error, or --limit."),
    ] = False,
    limit: Annotated[
        float | None,
        typer.Option(
            callback=in_range(0), help="Shrink it to the least that still gives this error [deg].", show_default=False
        ),
    ] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Search a moment budget for the disturbance with the largest attitude error in the nonlinear simulation.

    The search covers sines, square waves, held moments and turbulence. It starts from the weak directions of the
    linear loop and at random. The result is a lower bound: the true worst case is at least as bad. For an upper
    bound see `gustproof certify box`.

        gustproof worst-case hinf-d1 -o worst.toml && gustproof fly worst.toml --law hinf-d1

        gustproof worst-case hinf-scheduled --inertia-spread 0.2 --lag-spread 0.3 --json

    Shrunk, it has fewer moments, axes, strength, digits and seconds, and is written beside the worst one:

        gustproof worst-case my_mpc.py:make --flights 200 --limit 10 -o worst.toml
    """
    from pydantic_core import to_jsonable_python

    from firmware_model.config.vehicle import load_vehicle
    from gustproof.robust.uncertain.uncertainty import Spreads
    from gustproof.studies.worst_case.moment_search import worst_case as search

    moment = parse_positive_vector("--moment", budget)
    for path in _files(output, smallest=shrink or limit is not None):
        check_output(path, ".toml", "a scenario file")
    airframe = load_vehicle(vehicle)
    flown = find_controller(law, airframe)
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
            smallest = _shrink(found, flown, airframe, moment, limit, shown) if shrink or limit is not None else None
    except ValueError as error:
        raise ConfigError(str(error)) from None
    known = _find_warnings(found, flown, airframe)
    written = _save(found, smallest, airframe, output)
    if as_json:
        document = {
            "law": flown.name,
            "moment_nm": moment,
            "warnings": known,
            "files": [path for files in written for path in files],
            **to_jsonable_python(found),
            "smallest": to_jsonable_python(smallest),
        }
        print_json(to_jsonable_python(document, inf_nan_mode="null"))
        return
    for line in known:
        print(f"gustproof: warning: {line}", file=sys.stderr)
    _print(flown.name, found, horizon)
    _print_shrunk(smallest, limit)
    option = f"--{'controller' if is_user_controller(law) else 'law'} {shlex.quote(law)}"
    _print_how_to_fly(written, option, vehicle, found.seed)


def _print_how_to_fly(written: list[list[Path]], option: str, vehicle: str, seed: int) -> None:
    for script, *own in written:
        airframe = str(own[0]) if own else vehicle
        other = "" if airframe == "paper" else f" --vehicle {airframe}"
        print(f"fly it: gustproof fly {script} {option}{other} --seed {seed}")


def _find_warnings(found: "WorstCase", flown: "Controller", airframe: "Vehicle") -> list[str]:
    from gustproof.flight.routes.flight import warnings
    from gustproof.law.form import Law

    return list(warnings(found.scenario, flown, airframe)) if isinstance(flown, Law) else []


def _files(output: Path | None, *, smallest: bool) -> list[Path]:
    """Return the files that may be written, those of the smallest flight beside those of the worst."""
    if output is None:
        return []
    return [*flight_files(output), *(flight_files(_beside(output)) if smallest else ())]


def _beside(output: Path) -> Path:
    return output.with_name(f"{output.stem}-smallest.toml")


def _save(
    found: "WorstCase", smallest: "SmallestCase | None", airframe: "Vehicle", output: Path | None
) -> list[list[Path]]:
    """Write the worst flight, and the smallest beside it; return the files of each."""
    if output is None:
        return []
    written = [save_flight(found.scenario, found.vehicle, airframe, output)]
    if smallest is not None:
        written.append(save_flight(smallest.scenario, smallest.vehicle, airframe, _beside(output)))
    return written


def _shrink(
    found: "WorstCase",
    flown: "Controller",
    airframe: "Vehicle",
    budget: tuple[float, float, float],
    limit: float | None,
    shown: Callable[[float, str], None],
) -> "SmallestCase | None":
    """Return the smallest flight that gives the error asked for; `None` if the worst one found gives less."""
    from gustproof.studies.worst_case.shrink import shrink_case

    target = (_SHARE * found.peak_deg if math.isfinite(found.peak_deg) else 90.0) if limit is None else limit
    if not found.peak_deg >= target:
        return None
    title = f"shrinking, {flown.name}"
    return shrink_case(
        found, flown, vehicle=airframe, budget=budget, target_deg=target, progress=lambda share: shown(share, title)
    )


def _print_shrunk(smallest: "SmallestCase | None", limit: float | None) -> None:
    if smallest is None:
        if limit is not None:
            print(f"not shrunk: the worst flight found does not reach {limit:g} deg")
        return
    L, M, N = (f"{100.0 * share:.0f} %" for share in smallest.strength)
    peak = "diverges" if math.isinf(smallest.peak_deg) else f"{smallest.peak_deg:.2f} deg"
    terms = f"{smallest.terms} of {smallest.terms_before} moments"
    print(
        f"smallest that gives {smallest.target_deg:.2f} deg: {peak} in {smallest.scenario.duration_s:g} s, {terms}, "
        f"strength {L}, {M}, {N} about x, y, z; in {smallest.flights} more flights"
    )


def _print(law: str, found: "WorstCase", horizon: float) -> None:
    if math.isinf(found.peak_deg):
        print(f"{law}: diverges within {horizon:g} s; found in {found.flights} flights, from: {found.start}")
    else:
        phi, theta, psi = found.peaks_deg
        if max(phi, theta) > _TURNED_OVER_DEG:  # Euler angles count whole turns then: they are no tilt
            print(f"{law}: turns over in {horizon:g} s: roll reaches {phi:.0f} deg, pitch {theta:.0f}, yaw {psi:.0f}")
        else:
            peaks = f"roll {phi:.2f}, pitch {theta:.2f}, yaw {psi:.2f}"
            print(f"{law}: {found.peak_deg:.2f} deg ({peaks}) in {horizon:g} s")
        print(f"found in {found.flights} flights, from: {found.start} ({found.start_deg:.2f} deg there)")
        print(f"linear theory for the nominal vehicle predicts at most {found.linear_deg:.2f} deg in the budget")
