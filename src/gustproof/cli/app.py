"""The command line, assembled from one module for each command; those with modes are groups of subcommands."""

from collections.abc import Callable
from typing import Annotated, Any

import typer

from gustproof.cli.analyse import analyse
from gustproof.cli.audit import audit
from gustproof.cli.autopilot import fly as autopilot_fly
from gustproof.cli.autopilot import params, stand
from gustproof.cli.campaign.fly import fly as campaign_fly
from gustproof.cli.campaign.rare import rare
from gustproof.cli.campaign.rerun import rerun
from gustproof.cli.certify.air import air
from gustproof.cli.certify.box import box
from gustproof.cli.certify.check import check
from gustproof.cli.certify.gain import gain
from gustproof.cli.compare import compare
from gustproof.cli.controller.check import check as controller_check
from gustproof.cli.controller.run import run as controller_run
from gustproof.cli.design import design
from gustproof.cli.doctor import doctor
from gustproof.cli.export import export
from gustproof.cli.failures import OneLineErrors
from gustproof.cli.fly import fly
from gustproof.cli.guide import guide
from gustproof.cli.identify.log import identify
from gustproof.cli.identify.rates import rates
from gustproof.cli.judge import judge
from gustproof.cli.replay import replay
from gustproof.cli.report import report
from gustproof.cli.reproduce import reproduce
from gustproof.cli.scenario import scenario
from gustproof.cli.shipped import WithDefault, add_catalogue
from gustproof.cli.tune import tune
from gustproof.cli.wind_limit import wind_limit
from gustproof.cli.worst_case import worst_case
from gustproof.version import __version__

_MEANT = {"version": "--version", "help": "--help", "league": "compare course", "test": "doctor", "install": "doctor"}
"""Words that are no command, and what is meant."""


class _Panels(OneLineErrors):
    """Commands in the order of the panels: the main road on top."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands."""
        return [name for commands in PANELS.values() for name in commands]

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command, or tell what stands for one that other programs have, or that was here."""
        if (meant := _MEANT.get(args[0])) and args[0] not in self.commands:
            ctx.fail(f"No such command '{args[0]}': say gustproof {meant}")
        return super().resolve_command(ctx, args)


app = typer.Typer(
    name="gustproof",
    cls=_Panels,
    no_args_is_help=True,
    context_settings={"help_option_names": ["--help", "-h"]},
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="Design, prove and fly multirotor attitude control in gusts, over real MAVLink.",
    epilog=(
        "Exit status: 0 done, 1 a requirement failed, 2 bad input, 3 the flight broke off, 130 interrupted. "
        "`gustproof --install-completion` makes Tab complete commands, options and shipped names."
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


def _group(text: str, commands: dict[str, Callable[..., Any]], *, alone: bool = False) -> typer.Typer:
    """Return the group of some commands, of which the first does not need its name, nor arguments if it goes alone."""
    group = typer.Typer(cls=WithDefault, no_args_is_help=not alone, help=text)
    for name, command in commands.items():
        group.command(name)(command)
    return group


_identify = _group(
    "Identify a vehicle from the log of a flight, or by --connect the rate loops of an autopilot in flight.",
    {"log": identify, "rates": rates},
    alone=True,
)
_certify = _group(
    "Prove a bound on what disturbances do to a loop, or check a certificate.",
    {"box": box, "gain": gain, "air": air, "check": check},
)
_campaign = _group(
    "Fly one scenario many times, find a rare event, or fly one run again.",
    {"fly": campaign_fly, "rare": rare, "rerun": rerun},
)
_autopilot = _group(
    "Run the simulated vehicle alone: on the ground, or by --scenario through one; or print its parameters.",
    {"stand": stand, "fly": autopilot_fly, "params": params},
    alone=True,
)
_controller = _group(
    "Fly a law or a controller of your own against an autopilot, or check how it keeps to the protocol.",
    {"run": controller_run, "check": controller_check},
    alone=True,
)
_law = typer.Typer(no_args_is_help=True, help="List the shipped laws, and show one.")
_vehicle = typer.Typer(no_args_is_help=True, help="List the shipped vehicles, and show one.")
for kind, shown in (("law", _law), ("vehicle", _vehicle), ("design", design), ("scenario", scenario)):
    add_catalogue(shown, kind)

PANELS: dict[str, dict[str, tuple[Callable[..., Any] | typer.Typer, str]]] = {
    "Start": {
        "guide": (guide, "Open the guide in the browser; it needs no network."),
        "doctor": (doctor, "Check this installation, with a remedy for each fault."),
        "fly": (fly, "Fly one scenario: `gustproof fly gust-roll`."),
        "report": (report, "Write a page on flights or a campaign."),
        "replay": (replay, "Fly a recording again, and compare every bit."),
    },
    "Your vehicle": {
        "identify": (_identify, "Make a vehicle file from the log of a flight."),
        "tune": (tune, "Tune a law, or an autopilot's gains, for a vehicle."),
        "judge": (judge, "Judge gains: sound, fragile or unstable."),
        "export": (export, "Write a law as C, for an autopilot, or for MATLAB."),
    },
    "How sure": {
        "certify": (_certify, "Prove a gain or a box, or check a certificate."),
        "wind-limit": (wind_limit, "Find how much wind a vehicle stands."),
        "worst-case": (worst_case, "Search for the most harmful disturbance."),
        "campaign": (_campaign, "Fly one scenario many times."),
    },
    "Real autopilots": {
        "autopilot": (_autopilot, "Run the simulated vehicle alone, for ground stations."),
        "controller": (_controller, "Run or check a controller against an autopilot."),
        "compare": (compare, "Fly autopilots and laws until it is known which is better."),
    },
    "Research": {
        "design": (design, "Solve an H-infinity design; list and show designs."),
        "analyse": (analyse, "Show margins, poles, error budget and limits of a law."),
        "audit": (audit, "Test the physics of a simulator."),
        "reproduce": (reproduce, "Fly the paper with all laws, and judge its claims."),
    },
    "Files": {
        "scenario": (scenario, "List, show and check scenarios; extract wind."),
        "law": (_law, "List and show laws."),
        "vehicle": (_vehicle, "List and show vehicles."),
    },
}
"""Commands with what they do, in a line, as `gustproof --help` shows them: the main road on top."""
for panel, commands in PANELS.items():
    for name, (command, line) in commands.items():
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name, short_help=line, rich_help_panel=panel)
        else:
            app.command(name, short_help=line, rich_help_panel=panel)(command)
