"""The command `gustproof autopilot`: the vehicle's process."""

import typer

from gustproof.cli.failures import ExitStatus


def autopilot(ctx: typer.Context) -> None:
    """Run the simulated autopilot and its vehicle; `gustproof autopilot --help` shows its options.

    The same as `python -m firmware_model`. The vehicle stands on the ground in real time and speaks MAVLink over UDP.
    It uses the ports that ground stations and off-board programs expect, and prints how to connect each.

        gustproof autopilot

        gustproof autopilot --air paper-turbulence --held

        gustproof autopilot --scenario paper-turbulence
    """
    from firmware_model.__main__ import main

    raise typer.Exit(main(ctx.args, program="gustproof autopilot") or ExitStatus.DONE.value)
