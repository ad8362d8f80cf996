"""The command `gustproof fly`: one flight."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.flights import FLIGHT_FILES, NoTlog, Session, View, choose_autopilot
from gustproof.cli.laws import LAW_HELP, choose_law, on_vehicle
from gustproof.cli.options import (
    SEED,
    Anyway,
    AsJson,
    AutopilotName,
    Build,
    Params,
    VehicleName,
    check_output,
    complete,
    in_range,
)

if TYPE_CHECKING:
    from firmware_model.config.scenario import Scenario
    from firmware_model.config.vehicle import Vehicle
    from gustproof.flight.controllers.external_autopilot import AnyController
    from gustproof.flight.controllers.user_controller import Controller


def fly(
    context: typer.Context,
    scenario: Annotated[
        str,
        typer.Argument(
            help="Name of a shipped scenario, or a .toml file.", autocompletion=complete("scenario"), show_default=False
        ),
    ],
    law: Annotated[
        list[str] | None,
        typer.Option(
            help=f"{LAW_HELP} [default: flagship]. With --view, repeat it.",
            autocompletion=complete("law"),
            show_default=False,
        ),
    ] = None,
    controller: Annotated[
        str | None,
        typer.Option(
            help="Your own in place of a law: FILE.py:MAKER, LIBRARY.so, or 'exec: COMMAND' that speaks MAVLink.",
            show_default=False,
        ),
    ] = None,
    vehicle: VehicleName = "paper",
    seed: Annotated[int, SEED] = 1,
    real_time: Annotated[
        bool, typer.Option("--real-time", help="Fly at the pace of the clock, on usual ports.")
    ] = False,
    autopilot: AutopilotName = None,
    build: Build = "",
    params: Params = "",
    instance: Annotated[
        int | None,
        typer.Option(callback=in_range(0, 199), help="Its instance, which sets ports [default: a free one]."),
    ] = None,
    free: Annotated[bool, typer.Option("--free", help="Fly free, even if the scenario holds the vehicle.")] = False,
    view: View = False,
    no_tlog: NoTlog = False,
    anyway: Anyway = False,
    output: Annotated[
        list[Path] | None,
        typer.Option(
            "-o",
            "--output",
            help="New folder of the recording [default: in runs/], JUnit (.xml), ULog (.ulg); repeat it.",
        ),
    ] = None,
    ulog: Annotated[bool, typer.Option("--ulog", hidden=True, help="As -o SCENARIO.ulg.")] = False,
    as_json: AsJson = False,
) -> None:
    """Simulate one flight in gusts, and print how well the law held attitude.

    Autopilot and controller are two processes that speak MAVLink over UDP. Write a rosbag2 bag (MCAP) and the traffic
    (.tlog) to a folder. A controller of your own flies in a process of its own, see `gustproof guide controllers`. With
    --autopilot a real autopilot is started, armed and flown; --law then names a law built into it.

        gustproof fly paper-turbulence --law my-law.json --seed 7 -o run1 -o junit.xml
        gustproof fly gust-roll --law pid-fair --law flagship --view
        gustproof fly paper-turbulence --controller my_mpc.py:make
        gustproof fly paper-turbulence --controller "exec: node mine.mjs"
        gustproof fly paper-turbulence --autopilot px4 --build PX4-Autopilot
    """
    from firmware_model.config.vehicle import load_vehicle
    from gustproof.flight.routes.flight import FlightPlan

    written = [*(output or []), *([Path(f"{Path(scenario).stem}.ulg")] if ulog else [])]
    folder, files = _split_outputs(written, view=view)
    laws: list[str | None] = [*law] if law else [None]
    _refuse_several(laws, allowed=view and not (as_json or autopilot))
    chosen = choose_autopilot(context, autopilot, build, params, laws[0], instance)
    script = load_script(scenario, load_vehicle(vehicle), free=free)
    controllers: Sequence[tuple[AnyController, Vehicle]]
    if chosen:
        controllers, real_time = [(chosen, load_vehicle(vehicle))], real_time or not chosen.has_lockstep
    else:
        controllers = [
            _find_controller(script, each, controller, vehicle, anyway=anyway, quiet=as_json) for each in laws
        ]
    plans = [FlightPlan(script, flown, airframe, seed, real_time) for flown, airframe in controllers]
    Session(plans, tlog=not no_tlog, as_json=as_json, files=files).run(folder, view=view)


def _split_outputs(output: Sequence[Path], *, view: bool) -> tuple[Path | None, list[Path]]:
    """Return the folder of the recording, and the files to write; refuse what can't be written."""
    files = [path for path in output if path.suffix in FLIGHT_FILES]
    folders = [path for path in output if path not in files]
    if len(folders) > 1:
        raise ConfigError(f"-o: two folders for one recording, {folders[0]} and {folders[1]}")
    if files and view:
        raise ConfigError(f"{files[0]}: of one flight, and a page can fly again; fly without --view")
    for path in files:
        if os.path.lexists(path):
            raise ConfigError(f"{path}: exists already; nothing is overwritten")
        check_output(path, FLIGHT_FILES, "a file of a flight")
    return (folders[0] if folders else None), files


def _refuse_several(laws: Sequence[str | None], *, allowed: bool) -> None:
    if len(laws) > 1 and not allowed:
        raise ConfigError(
            "several --law need --view, and our own autopilot; or fly each, then: gustproof report RUN RUN"
        )


def load_script(scenario: str, vehicle: "Vehicle", *, free: bool) -> "Scenario":
    """Return the scenario with the vehicle's delay, in free flight if `free`; its name then says so."""
    from dataclasses import replace

    from firmware_model.config.scenario import load_scenario

    script = on_vehicle(load_scenario(scenario), vehicle)
    return replace(script, name=f"{script.name}-free", translation="free") if free and not script.free else script


def _find_controller(
    script: "Scenario", law: str | None, controller: str | None, vehicle: str, *, anyway: bool, quiet: bool
) -> "tuple[Controller, Vehicle]":
    """Return law or controller, by default a law for the vehicle, and the vehicle; refuse what should not begin."""
    from firmware_model.config.uncertainty import load_vehicle_set
    from gustproof.flight.controllers.user_controller import parse_controller
    from gustproof.flight.routes.flight import check

    if controller is not None and law is not None:
        raise ConfigError("--controller flies in place of a law; --law cannot be given with it")
    vehicles = load_vehicle_set(vehicle)
    flown: Controller = (
        choose_law(law, vehicles, script, quiet=quiet) if controller is None else parse_controller(controller)
    )
    if not anyway:
        check(script, flown, vehicles.nominal)
    return flown, vehicles.nominal
