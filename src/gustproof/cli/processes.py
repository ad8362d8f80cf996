"""The commands `gustproof autopilot` and `gustproof controller`: processes of a flight, with options of their own."""

import typer


def autopilot(context: typer.Context) -> None:
    """Run the simulated autopilot and its vehicle; `gustproof autopilot --help` shows its options.

    The same as `python -m firmware_model`. The vehicle stands on the ground in real time and speaks MAVLink over UDP.
    It uses the ports that ground stations and off-board programs expect, and prints how to connect each.

        gustproof autopilot

        gustproof autopilot --air paper-turbulence --held

        gustproof autopilot --scenario paper-turbulence
    """
    from firmware_model.__main__ import main

    raise typer.Exit(main(context.args, program="gustproof autopilot"))


def controller(context: typer.Context) -> None:
    """Fly a law file against an autopilot over MAVLink; `gustproof controller --help` shows its options.

    gustproof controller --law hinf-scheduled
    """
    from gustproof.controller.__main__ import main

    raise typer.Exit(main(context.args))
