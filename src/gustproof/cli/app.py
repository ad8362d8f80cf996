"""The command line, assembled from one module for each subcommand."""

from typing import Annotated

import typer

from gustproof.cli.analyse import analyse
from gustproof.cli.audit import audit
from gustproof.cli.campaign import campaign
from gustproof.cli.certify import certify
from gustproof.cli.check_controller import check_controller
from gustproof.cli.compare import compare
from gustproof.cli.design import design
from gustproof.cli.doctor import doctor
from gustproof.cli.export import export
from gustproof.cli.failures import OneLineErrors
from gustproof.cli.fly import fly
from gustproof.cli.guide import guide
from gustproof.cli.identify import identify
from gustproof.cli.identify_rates import identify_rates
from gustproof.cli.judge import judge
from gustproof.cli.league import league
from gustproof.cli.processes import autopilot, controller
from gustproof.cli.recover import recover
from gustproof.cli.report import report
from gustproof.cli.reproduce import reproduce
from gustproof.cli.scenario import scenario
from gustproof.cli.shipped import WithDefault, add_catalogue
from gustproof.cli.tune import tune
from gustproof.cli.worst_case import worst_case
from gustproof.version import __version__

app = typer.Typer(
    name="gustproof",
    cls=OneLineErrors,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="Design, prove and fly multirotor attitude control in gusts, over real MAVLink.",
    epilog=(
        "Exit status: 0 done, 1 a requirement failed, 2 bad input, 3 the flight broke off, 130 interrupted. "
        "Start with `gustproof guide` or `gustproof fly gust-roll`, and `gustproof doctor` if something fails. "
        "`gustproof --install-completion` makes Tab complete commands, options and shipped names in bash, zsh, fish "
        "and PowerShell."
    ),
)


def _print_version(*, wanted: bool) -> None:
    if wanted:
        print(f"gustproof {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    _version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass


law = typer.Typer(no_args_is_help=True, help="List the shipped laws, and show one.")
vehicle = typer.Typer(no_args_is_help=True, help="List the shipped vehicles, and show one.")
designs = typer.Typer(
    cls=WithDefault, help="Solve an H-infinity design, or list and show the shipped ones: `design list`."
)
designs.command("solve")(design)
for kind, group in (("law", law), ("vehicle", vehicle), ("design", designs), ("scenario", scenario)):
    add_catalogue(group, kind)
app.command()(guide)
app.command()(reproduce)
app.add_typer(designs, name="design")
app.command()(identify)
app.command()(tune)
app.command()(identify_rates)
app.add_typer(scenario, name="scenario")
app.add_typer(vehicle, name="vehicle")
app.add_typer(law, name="law")
app.command()(fly)
app.command()(check_controller)
app.command()(recover)
app.command()(doctor)
app.command()(campaign)
app.command()(compare)
app.command()(league)
app.command()(certify)
app.command()(worst_case)
app.command()(report)
app.command()(analyse)
app.command()(judge)
app.command()(audit)
app.command()(export)
app.command()(autopilot)
app.command()(controller)
