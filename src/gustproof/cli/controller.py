"""The command `gustproof controller`: the controller's process."""

import typer

from gustproof.cli.failures import ExitStatus


def controller(ctx: typer.Context) -> None:
    """Fly a law file against an autopilot over UDP; `gustproof controller --help` shows its options.

    gustproof controller --law hinf-scheduled
    """
    from gustproof.controller.__main__ import main

    raise typer.Exit(main(ctx.args) or ExitStatus.DONE.value)
