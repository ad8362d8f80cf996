"""The command `gustproof wind-limit`: the wind that a vehicle stands."""

from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.campaign.plan import Workers, describe_start, open_pool
from gustproof.cli.failures import ExitStatus, exit_with
from gustproof.cli.laws import LAW_HELP, choose_law, is_parameter_file, on_vehicle
from gustproof.cli.options import (
    COMPILING,
    SEED,
    AsJson,
    Build,
    Force,
    check_output,
    complete,
    in_range,
    print_again,
    print_json,
    print_next,
    progress,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    from firmware_model.config.scenario import Scenario
    from firmware_model.config.uncertainty import VehicleSet
    from gustproof.flight.controllers.external_autopilot import ExternalAutopilot
    from gustproof.law.form import Law
    from gustproof.studies.wind_limit.kept import Kept
    from gustproof.studies.wind_limit.real_flights import RealFlight
    from gustproof.studies.wind_limit.wind_limit import WindLimit

_LEAST_RISK = 1e-8


class _Asked(NamedTuple):
    """Request of a command line."""

    law: "Law"
    """Law, or loops as one."""
    vehicles: "VehicleSet"
    """Vehicle with its spreads."""
    base: "Scenario"
    """Height, rates and delay."""
    kept: "tuple[Kept, ...]"
    """Requirements."""
    risk: float
    """[-] accepted probability that a minute breaks one."""
    seed: int
    """Seed of all draws."""
    with_map: bool
    """True if the map of mean wind and turbulence is flown too."""


def wind_limit(
    context: typer.Context,
    vehicle: Annotated[
        str, typer.Argument(help="Name of a shipped vehicle, or a .toml file.", autocompletion=complete("vehicle"))
    ],
    law: Annotated[
        str | None,
        typer.Option(
            help=f"{LAW_HELP} Without it the flagship, tuned for the vehicle.",
            autocompletion=complete("law"),
            show_default=False,
        ),
    ] = None,
    keep: Annotated[
        str, typer.Option(help="What a minute must keep: tilt, error, yaw, rmse [deg], drift [m], saturated [%].")
    ] = "tilt<35, saturated<1 %",
    risk: Annotated[
        float,
        typer.Option(
            callback=in_range(_LEAST_RISK, 0.3),
            help="Accepted probability that a minute breaks it; small ones take long.",
        ),
    ] = 1e-3,
    build: Build = "",
    workers: Workers = None,
    seed: Annotated[int, SEED] = 1,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="Write a page here (.html), and the flight at the limit beside it (.toml)."
        ),
    ] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Find how much wind a vehicle stands, in metres a second at 20 ft.

    In free flight the law tilts into the mean wind and holds its place on average. If drift is kept, the vehicle's
    position loop flies around it, by [position] of its file. The turbulence of that wind comes on top (MIL-F-8785C),
    from the worst direction, over the spreads in the vehicle file. Sequential tests show on which side of the limit a
    speed is: both ends are right with 95 %. Single 1-cos gusts are searched over directions and lengths, in calm air.
    Beside them stands the gust that is proved. With --build the parameters of --law fly in the real autopilot too, in
    the winds around the limit.

    gustproof wind-limit my-quad.toml --law my.params --keep "tilt<35, drift<3 m" -o limit.html

        gustproof wind-limit iris --keep "error<10, saturated<1 %" --risk 1e-2
    """
    from firmware_model.config.scenario import load_scenario
    from firmware_model.config.uncertainty import load_vehicle_set
    from gustproof.flight.routes.flight import check
    from gustproof.studies.rate.judge import scenario_for
    from gustproof.studies.wind_limit.kept import needs_place, parse_keep

    kept = parse_keep(keep)
    if build and needs_place(kept):
        raise ConfigError("--build: a real autopilot flies its own position loop, which is not the one of drift")
    flight = _check_files(output, law, build)
    vehicles = load_vehicle_set(vehicle)
    usual, pool = load_scenario("paper-turbulence"), open_pool(workers)
    flown = choose_law(law, vehicles, on_vehicle(usual, vehicles.nominal), quiet=as_json)
    base = scenario_for(flown, vehicles.nominal, usual)
    check(base, flown, vehicles.nominal)
    real = _find_real(law, build, flown)
    study = _Asked(flown, vehicles, base, kept, risk, seed, with_map=output is not None)
    found = _search(study, pool, describe_start(workers, f"wind limit of {flown.name}"), quiet=as_json)
    written = _write(found, vehicles, flown, output, flight)
    checked = _fly_real(found, vehicles, real, flown, quiet=as_json)
    if as_json:
        print_json(
            {**found.to_dict(), "real": [each._asdict() for each in checked], "files": [str(path) for path in written]}
        )
        return
    _show(found, checked)
    print("".join(f"{path} is written\n" for path in written), end="")
    if output is None:
        print_again(context, "-o", f"{Path(vehicle).stem}-wind.html")
    elif flight in written:
        print_next("fly", flight, *(() if law is None else ("--law", law)), "--vehicle", vehicle)


def _check_files(output: Path | None, law: str | None, build: str) -> Path | None:
    """Return the scenario file to write beside a page; refuse what can't be written, and a build without parameters.

    Raises
    ------
    ConfigError
        If a build is given, and the law is no parameter file.
    """
    check_output(output, ".html", "a page")
    flight = None if output is None else output.with_suffix(".toml")
    check_output(flight, ".toml", "a scenario file")
    if build and not (law and is_parameter_file(law)):
        raise ConfigError("--build: flies the parameters of --law, a file of PX4 or ArduPilot")
    return flight


def _search(asked: "_Asked", workers: AbstractContextManager[Any], title: str, *, quiet: bool) -> "WindLimit":
    """Return the limit, with progress on stderr that begins with a title."""
    from dataclasses import replace

    from gustproof.flight.routes.batch import is_cold
    from gustproof.studies.wind_limit.wind_limit import find_wind_limit

    cold = COMPILING * is_cold(replace(asked.base, translation="free"))
    try:
        with progress(title + cold, quiet=quiet) as shown, workers as pool:
            return find_wind_limit(
                asked.law,
                asked.vehicles,
                asked.base,
                asked.kept,
                pool,
                risk=asked.risk,
                seed=asked.seed,
                with_map=asked.with_map,
                progress=shown,
            )
    except KeyboardInterrupt:
        raise exit_with("interrupted; nothing is kept", ExitStatus.INTERRUPTED) from None
    except ValueError as error:
        raise ConfigError(f"law '{asked.law.name}': {error}") from None


def _write(
    found: "WindLimit", vehicles: "VehicleSet", law: "Law", output: Path | None, flight: Path | None
) -> list[Path]:
    """Write the page, and the flight at the limit if there is one; return the files."""
    if output is None or flight is None:
        return []
    from firmware_model.config.files import write_toml
    from gustproof.show.report.html.wind_page import write_wind_page

    write_wind_page(found, vehicles.nominal, law, output)
    if found.scenario is None:
        return [output]
    write_toml(found.scenario, flight)
    return [output, flight]


def _find_real(parameters: str | None, build: str, law: "Law") -> "ExternalAutopilot | None":
    """Return the autopilot whose loops a law stands for, if a build is given."""
    if not build or parameters is None:
        return None
    from gustproof.flight.controllers.external_autopilot import ExternalAutopilot
    from gustproof.studies.rate.advice import autopilot_kind

    kind = autopilot_kind(law)
    assert kind is not None  # as it is of a parameter file
    return ExternalAutopilot(kind=kind, build=build, parameters=parameters)


def _fly_real(
    found: "WindLimit", vehicles: "VehicleSet", autopilot: "ExternalAutopilot | None", law: "Law", *, quiet: bool
) -> "list[RealFlight]":
    if autopilot is None:
        return []
    from gustproof.studies.wind_limit.real_flights import fly_real

    with progress(f"flying {autopilot.name}", quiet=quiet) as shown:
        return fly_real(
            found.around, vehicles.nominal, autopilot, law, found.kept, (1, 2, 3), lambda text: shown(0.5, text)
        )


def _show(found: "WindLimit", checked: "list[RealFlight]") -> None:
    from gustproof.show.report.terminal import show
    from gustproof.show.report.wind_lines import render_wind_limit

    show(render_wind_limit(found))
    for wind in dict.fromkeys(each.wind for each in checked):
        flights = [each for each in checked if each.wind == wind]
        real, model = (_range(each.real for each in flights), _range(each.model for each in flights))
        print(f"real autopilot, {wind}: {real} of the limit in {len(flights)} flights, its model {model}")


def _range(values: "Iterable[float]") -> str:
    found = sorted(values)
    return f"{found[0]:.3g} to {found[-1]:.3g}"
