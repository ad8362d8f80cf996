"""The command `gustproof identify log`: vehicle, air and sensors from the log of a flight."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.options import (
    AsJson,
    FlightBegin,
    FlightEnd,
    Force,
    check_output,
    parse_positive_vector,
    print_again,
    print_json,
    print_next,
    progress,
)

if TYPE_CHECKING:
    from gustproof.logs.identify.shown_vehicle import ShownVehicle
    from gustproof.logs.read.flight_log import FlightLog

_POSITIVE = 1e-6
_Outputs = dict[str, Path | None]


def identify(
    context: typer.Context,
    log: Annotated[
        Path,
        typer.Argument(
            help="Log: ULog, DataFlash .bin, .tlog, our bag, a Crazyflie's log or .csv.", show_default=False
        ),
    ],
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Write the vehicle here, a new .toml.")] = None,
    begin: FlightBegin = None,
    end: FlightEnd = None,
    report: Annotated[Path | None, typer.Option(help="Write curves and numbers here, a new .html.")] = None,
    wind: Annotated[
        Path | None, typer.Option(help="Write the disturbance as wind for `replay` here, a new .csv.")
    ] = None,
    scenario: Annotated[
        Path | None, typer.Option(help="Write a scenario of the same turbulence here, a new .toml.")
    ] = None,
    like: Annotated[
        str | None, typer.Option(help="Vehicle that gives the numbers which no log shows [default: iris, scaled].")
    ] = None,
    mass: Annotated[float | None, typer.Option(min=_POSITIVE, help="Mass [kg].")] = None,
    thrust_max: Annotated[float | None, typer.Option(min=_POSITIVE, help="Largest thrust of one rotor [N].")] = None,
    inertia: Annotated[str | None, typer.Option(help="Moments of inertia x,y,z [kg*m^2], if known.")] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Identify a vehicle from the log of one flight: gains, lag, delay, damping, gyro noise, and the air it flew in.

    Each number has a 95 % interval, which becomes its spread in the vehicle file.

        gustproof identify flight.ulg -o my-quad.toml --mass 2.1 --report my-quad.html
        gustproof identify runs/fly-001 -o my-quad.toml --wind gust.csv --scenario gust.toml

    An axis that the flight does not excite is named, with the manoeuvre that would. `gustproof fly doublets` flies it.
    """
    from firmware_model.config.vehicle import load_vehicle
    from gustproof.logs.identify.shown_vehicle import show_vehicle
    from gustproof.logs.identify.vehicle_file import Known
    from gustproof.logs.read.flown_part import crop
    from gustproof.logs.read.read_log import read_log
    from gustproof.studies.logged_flight import check_class

    outputs = {"vehicle": output, "report": report, "wind": wind, "scenario": scenario}
    suffixes = {"report": (".html", "a report"), "wind": (".csv", "a replay"), "scenario": (".toml", "a scenario")}
    for kind, path in outputs.items():
        suffix, name = suffixes.get(kind, (".toml", "a vehicle"))
        check_output(path, suffix, name)
    known = Known(
        like=like,
        mass=mass,
        thrust_max=thrust_max,
        inertia_B=None if inertia is None else parse_positive_vector("--inertia", inertia),
    )
    if like is not None:
        load_vehicle(like)  # refused before the work, not after it
    title = f"identify {log}"
    with progress(f"reading {log}", quiet=as_json) as shown:
        flight, name = crop(read_log(log), begin, end), (output or log).stem
        check_class(flight)
        found = show_vehicle(flight, name, known, progress=lambda share: shown(share, title))
        _write(flight, found, outputs)
    if as_json:
        from gustproof.show.report.vehicle_numbers import identification_document

        files = {kind: None if path is None else str(path) for kind, path in outputs.items()}
        print_json(identification_document(found) | {"files": files})
        return
    from gustproof.show.report.terminal import show
    from gustproof.show.report.vehicle_numbers import render_identification

    show(render_identification(found))
    _tell_outputs(context, outputs, flight, has_vehicle=found.file is not None)


def _tell_outputs(context: typer.Context, outputs: _Outputs, flight: "FlightLog", *, has_vehicle: bool) -> None:
    """Print the files that are written, and the next command: from the gains that flew, if the log has them."""
    from gustproof.design.loops.models import AUTOPILOTS

    for kind, path in outputs.items():
        if path is not None:
            print(f"{kind} in {path}")
    has_gains = flight.system in AUTOPILOTS and bool(flight.parameters)
    if (output := outputs["vehicle"]) and has_gains:
        print_next("tune", output, "--from", context.params["log"], "-o", output.with_suffix(".params"))
    elif output:
        print_next("tune", output, "-o", output.with_suffix(".json"))
    elif has_vehicle:
        print_again(context, "-o", "my-quad.toml", without=outputs)


def _write(flight: "FlightLog", found: "ShownVehicle", outputs: _Outputs) -> None:
    """Write all that is asked for, or nothing if the log does not tell something of it."""
    from firmware_model.config.files import write_text, write_toml
    from gustproof.logs.identify.air import replay_text
    from gustproof.show.report.html.log_page import write_log_report
    from gustproof.studies.logged_flight import study_loops, with_vehicle

    file, air, scenario = found.file, found.air, found.scenario()
    writers: dict[str, Callable[[Path], object]] = {
        "report": lambda path: write_log_report(with_vehicle(study_loops(flight), found), path)
    }
    if file is not None:
        writers["vehicle"] = lambda path: write_text(path, file.text)
    if file is not None and air is not None and scenario is not None:
        writers["wind"] = lambda path: write_text(path, replay_text(air, file.vehicle))
        writers["scenario"] = lambda path: write_toml(replace(scenario, name=path.stem), path)
    asked = {kind: path for kind, path in outputs.items() if path}
    if not asked.keys() <= writers.keys():
        raise ConfigError(found.refusal)
    for kind, path in asked.items():
        writers[kind](path)
