"""The commands `gustproof autopilot` and `gustproof controller`: each runs a process of a flight alone."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from gustproof.cli.options import SEED, VehicleName, complete
from gustproof.controller import DEFAULT_LAW
from gustproof.errors import FlightError

_SCENARIO = "a .toml file, or the name of a shipped one"
_SIGNING_KEY = typer.Option(
    metavar="FILE",
    help="Sign every message and reject those without this key: 32 bytes or 64 hex digits, readable by you alone.",
)
_UNSIGNED = typer.Option("--unsigned", help="Accept commands from anyone on the network, without a key.")
_JSON = typer.Option("--json", help="Print JSON, one object a line.")


class Dialect(StrEnum):
    """Dialect of MAVLink that a vehicle speaks."""

    PX4 = "px4"
    GENERIC = "generic"


class Via(StrEnum):
    """Message that carries a law's command."""

    TORQUE = "torque"
    RATES = "rates"


class Height(StrEnum):
    """Thrust beside rates."""

    HOLD = "hold"
    FREE = "free"


class Attitude(StrEnum):
    """Attitude that a law with an estimate works with."""

    AUTOPILOT = "autopilot"
    OWN = "own"


def autopilot(
    scenario: Annotated[
        str | None,
        typer.Option(help=f"Fly this scenario and exit: {_SCENARIO}.", autocompletion=complete("scenario")),
    ] = None,
    air: Annotated[
        str | None,
        typer.Option(
            help=f"Scenario that gives wind and moments, from its start: {_SCENARIO} [default: calm].",
            autocompletion=complete("scenario"),
        ),
    ] = None,
    held: Annotated[
        bool, typer.Option("--held", help="Test stand: hold the vehicle in place, free in attitude while armed.")
    ] = False,
    vehicle: VehicleName = "paper",
    seed: Annotated[int, SEED] = 1,
    lockstep: Annotated[
        bool, typer.Option("--lockstep", help="Fly the scenario as fast as its samples are answered.")
    ] = False,
    instance: Annotated[
        int,
        typer.Option(
            min=0, max=253, help="Number N of this vehicle, added to all ports; the system id in MAVLink is N + 1."
        ),
    ] = 0,
    bind_port: Annotated[
        int | None,
        typer.Option(help="Listen on this port only, 0 for a free one [default: 18570 and 14580].", show_default=False),
    ] = None,
    bind: Annotated[
        str, typer.Option(metavar="HOST", help="Local address to listen on, 0.0.0.0 for all.")
    ] = "127.0.0.1",
    signing_key: Annotated[Path | None, _SIGNING_KEY] = None,
    unsigned: Annotated[bool, _UNSIGNED] = False,
    journal: Annotated[Path | None, typer.Option(help="New file for the records of the flight.")] = None,
    tlog: Annotated[
        Path | None, typer.Option(help="New telemetry log of the MAVLink traffic, a format of ground stations.")
    ] = None,
    autopilot: Annotated[Dialect, typer.Option(help="Dialect of MAVLink.")] = Dialect.PX4,
    params: Annotated[
        bool, typer.Option("--params", help="Print all parameters with units, ranges and meanings, and exit.")
    ] = False,
    json: Annotated[bool, _JSON] = False,
) -> None:
    """Run the simulated autopilot and its vehicle alone, for ground stations and programs of your own.

    Without `--scenario` it stands on the ground in real time until Ctrl-C. With `--scenario` it is clamped until it is
    armed and in OFFBOARD, then flies the scenario and exits. It uses the ports that ground stations and off-board
    programs expect, and prints how to connect each. Its MAVLink is like that of PX4's simulation, but it is not PX4.

        gustproof autopilot

        gustproof autopilot --air paper-turbulence --held

        gustproof autopilot --scenario paper-turbulence

    Exit status: 0 flown in OFFBOARD to the end, 2 bad input, 3 the flight broke off, 130 interrupted.
    """
    given = dict(locals())
    from firmware_model.__main__ import VehicleOptions, run
    from firmware_model.errors import RecordingError

    try:
        raise typer.Exit(run(VehicleOptions(**given)))
    except RecordingError as error:
        raise FlightError(str(error)) from None


def controller(
    law: Annotated[
        str, typer.Option(help="Name of a shipped law, or a .json file.", autocompletion=complete("law"))
    ] = DEFAULT_LAW,
    controller: Annotated[
        str | None,
        typer.Option(
            help="Fly a controller of your own in place of a law: FILE.py:MAKER, PACKAGE.MODULE:MAKER or LIBRARY.so.",
            show_default=False,
        ),
    ] = None,
    vehicle: VehicleName = "paper",
    via: Annotated[
        Via | None, typer.Option(help="Message for the command [default: the law's output].", show_default=False)
    ] = None,
    connect: Annotated[
        str,
        typer.Option(help="The autopilot: [udp:]HOST:PORT, udpin:HOST:PORT to listen there, or tcp:HOST:PORT."),
    ] = "127.0.0.1:14580",
    bind_port: Annotated[
        int | None,
        typer.Option(
            help="Port to send from, 0 for a free one [default: 14540 + N for PX4's simulation at 14580 + N].",
            show_default=False,
        ),
    ] = None,
    signing_key: Annotated[Path | None, _SIGNING_KEY] = None,
    unsigned: Annotated[bool, _UNSIGNED] = False,
    height: Annotated[
        Height,
        typer.Option(help="Thrust beside rates after a pilot has flown: hold the height, or send the hover thrust."),
    ] = Height.HOLD,
    attitude: Annotated[
        Attitude,
        typer.Option(help="Attitude of a law with an estimate after a pilot has flown: by ATTITUDE, or its own."),
    ] = Attitude.AUTOPILOT,
    scenario: Annotated[
        str | None,
        typer.Option(
            help=f"Attitude references to hold: those of a scenario, {_SCENARIO} [default: level].",
            autocompletion=complete("scenario"),
            show_default=False,
        ),
    ] = None,
    real_time: Annotated[
        bool, typer.Option("--real-time", help="Request real-time scheduling (SCHED_FIFO); not for lockstep.")
    ] = False,
    json: Annotated[bool, _JSON] = False,
) -> None:
    """Fly a law, or a controller of your own, against an autopilot over MAVLink.

    It finds the autopilot, reads its limits and answers every sample. A vehicle that waits for its script is armed and
    flown in OFFBOARD to the end. If a pilot is flying, it takes over once. It yields on any mode change. It flies again
    when OFFBOARD, or GUIDED of ArduPilot, is set. Ctrl-C hands back to HOLD, or BRAKE.

        gustproof controller --law hinf-scheduled

        gustproof controller --law hinf-rates --via rates --connect udp:127.0.0.1:14580

    Exit status: 0 flown to the end, 2 bad input, 3 the flight broke off, 130 interrupted.
    """
    given = dict(locals())
    from gustproof.controller.__main__ import ControllerOptions, run

    raise typer.Exit(run(ControllerOptions(**given)))
