"""The command `gustproof controller run`: a law, or a controller of the user's, against an autopilot."""

from enum import StrEnum
from typing import Annotated

import typer

from gustproof.cli.links import SCENARIO, JsonLines, SigningKey
from gustproof.cli.options import VehicleName, complete
from gustproof.flight.endpoint import DEFAULT_LAW


class Via(StrEnum):
    """Message that carries a law's command."""

    TORQUE = "torque"
    RATES = "rates"


class Height(StrEnum):
    """Thrust beside rates."""

    HOLD = "hold"
    FREE = "free"


class EstimateSource(StrEnum):
    """Attitude that a law with an estimate works with."""

    AUTOPILOT = "autopilot"
    OWN = "own"


def run(
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
    signing_key: SigningKey = None,
    height: Annotated[
        Height,
        typer.Option(help="Thrust beside rates after a pilot has flown: hold the height, or send the hover thrust."),
    ] = Height.HOLD,
    attitude: Annotated[
        EstimateSource,
        typer.Option(help="Attitude of a law with an estimate after a pilot has flown: by ATTITUDE, or its own."),
    ] = EstimateSource.AUTOPILOT,
    scenario: Annotated[
        str | None,
        typer.Option(
            help=f"Attitude references to hold: those of a scenario, {SCENARIO} [default: level].",
            autocompletion=complete("scenario"),
            show_default=False,
        ),
    ] = None,
    real_time: Annotated[
        bool, typer.Option("--real-time", help="Request real-time scheduling (SCHED_FIFO); not for lockstep.")
    ] = False,
    json: JsonLines = False,
) -> None:
    """Fly a law, or a controller of your own, against an autopilot over MAVLink.

    It finds the autopilot, reads its limits and answers every sample. A vehicle that waits for its script is armed and
    flown in OFFBOARD to the end. If a pilot is flying, it takes over once. It yields on any mode change. It flies again
    when OFFBOARD, or GUIDED of ArduPilot, is set. Ctrl-C hands back to HOLD, or BRAKE.

        gustproof controller run --law hinf-scheduled
        gustproof controller run --law hinf-rates --via rates --connect udp:127.0.0.1:14580

    Exit status: 0 flown to the end, 2 bad input, 3 the flight broke off, 130 interrupted.
    """
    given = dict(locals())
    from gustproof.flight.endpoint.__main__ import ControllerOptions
    from gustproof.flight.endpoint.__main__ import run as fly

    raise typer.Exit(fly(ControllerOptions(**given)))
