"""The commands `gustproof autopilot`: the simulated vehicle alone, on the ground or in a scenario; its parameters."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from gustproof.cli.links import SCENARIO, JsonLines, SigningKey
from gustproof.cli.options import SEED, VehicleName, complete, in_range
from gustproof.errors import FlightError


class SpokenDialect(StrEnum):
    """Dialect of MAVLink that a vehicle speaks."""

    PX4 = "px4"
    GENERIC = "generic"


_Air = Annotated[
    str | None,
    typer.Option(
        help=f"Scenario that gives wind and moments, from its start: {SCENARIO} [default: calm].",
        autocompletion=complete("scenario"),
        show_default=False,
    ),
]
_Instance = Annotated[
    int,
    typer.Option(
        callback=in_range(0, 253),
        help="Number N of this vehicle, added to all ports; the system id in MAVLink is N + 1.",
    ),
]
_BindPort = Annotated[
    int | None,
    typer.Option(help="Listen on this port only, 0 for a free one [default: 18570 and 14580].", show_default=False),
]
_Bind = Annotated[str, typer.Option(metavar="HOST", help="Local address to listen on, 0.0.0.0 for all.")]
_Journal = Annotated[Path | None, typer.Option(help="New file for the records of the flight.", show_default=False)]
_Log = Annotated[
    Path | None, typer.Option(help="New telemetry log of the traffic, as of ground stations.", show_default=False)
]
_Dialect = Annotated[SpokenDialect, typer.Option(help="Dialect of MAVLink.")]


def stand(
    air: _Air = None,
    held: Annotated[
        bool, typer.Option("--held", help="Test stand: hold the vehicle in place, free in attitude while armed.")
    ] = False,
    vehicle: VehicleName = "paper",
    seed: Annotated[int, SEED] = 1,
    instance: _Instance = 0,
    bind_port: _BindPort = None,
    bind: _Bind = "127.0.0.1",
    signing_key: SigningKey = None,
    journal: _Journal = None,
    tlog: _Log = None,
    autopilot: _Dialect = SpokenDialect.PX4,
    json: JsonLines = False,
) -> None:
    """Run the simulated autopilot and its vehicle in real time until Ctrl-C, for ground stations and programs.

    It stands on the ground, disarmed, on the ports where clients look, and prints how to connect each. Its MAVLink is
    like that of PX4's simulation, but it is not PX4.

        gustproof autopilot
        gustproof autopilot --air paper-turbulence --held
    """
    _run(**locals())


def fly(
    scenario: Annotated[
        str, typer.Option(help=f"The scenario: {SCENARIO}.", autocompletion=complete("scenario"), show_default=False)
    ],
    lockstep: Annotated[bool, typer.Option("--lockstep", help="Fly as fast as the samples are answered.")] = False,
    vehicle: VehicleName = "paper",
    seed: Annotated[int, SEED] = 1,
    instance: _Instance = 0,
    bind_port: _BindPort = None,
    bind: _Bind = "127.0.0.1",
    signing_key: SigningKey = None,
    journal: _Journal = None,
    tlog: _Log = None,
    autopilot: _Dialect = SpokenDialect.PX4,
    json: JsonLines = False,
) -> None:
    """Run the simulated autopilot and its vehicle for one scenario, and exit.

    The vehicle is clamped until it is armed and in OFFBOARD, then flies. `--scenario` alone names this mode.

        gustproof autopilot --scenario paper-turbulence

    Exit status: 0 flown in OFFBOARD to the end, 2 bad input, 3 the flight broke off, 130 interrupted.
    """
    _run(**locals())


def params(
    air: _Air = None,
    vehicle: VehicleName = "paper",
    autopilot: _Dialect = SpokenDialect.PX4,
    json: JsonLines = False,
) -> None:
    """Print all parameters with units, ranges and meanings.

    gustproof autopilot params --vehicle iris
    """
    _run(**locals(), params=True)


def _run(**given: Any) -> None:
    """Run the vehicle with options as `VehicleOptions` has them, and exit with its status."""
    from firmware_model.__main__ import VehicleOptions, run
    from firmware_model.errors import RecordingError

    try:
        raise typer.Exit(run(VehicleOptions(**given)))
    except RecordingError as error:
        raise FlightError(str(error)) from None
