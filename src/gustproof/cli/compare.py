"""The command `gustproof compare`: a real autopilot's loops, a law inside it, and the law here."""

from typing import TYPE_CHECKING, Annotated

import typer

from gustproof.cli.flights import tell_rate
from gustproof.cli.laws import LAW_HELP, find_law
from gustproof.cli.options import AsJson, Build, VehicleName, complete, print_json, progress

if TYPE_CHECKING:
    from gustproof.law.form import Law


def compare(
    scenario: Annotated[
        str, typer.Argument(help="Name of a shipped scenario, or a .toml file.", autocompletion=complete("scenario"))
    ] = "paper-turbulence",
    autopilot: Annotated[str, typer.Option(help="Real autopilot: px4 or ardupilot.")] = "px4",
    build: Build = "",
    params: Annotated[
        list[str] | None,
        typer.Option(help="Parameters of its own loops, a shipped set or a file; repeat it [default: stock, tuned]."),
    ] = None,
    law: Annotated[
        str, typer.Option(help=f"Law to fly beside them. {LAW_HELP}", autocompletion=complete("law"))
    ] = "flagship",
    inside: Annotated[
        str, typer.Option(help="Build with that law inside, made by gustproof export [default: none].")
    ] = "",
    runs: Annotated[int, typer.Option(min=1, help="Seeds 1, 2, … of each.")] = 3,
    free: Annotated[bool, typer.Option("--free", help="Fly free, even if the scenario holds the vehicle.")] = False,
    vehicle: VehicleName = "paper",
    as_json: AsJson = False,
) -> None:
    """Fly a real autopilot's own loops and a law of ours in the same gusts, and print one table.

    The table shows medians over the seeds: the attitude error with and without each axis' mean, and its torque slew.
    Another column is the error that the autopilot sees itself.

        gustproof compare paper-turbulence --autopilot px4 --build PX4-Autopilot --inside PX4-with-flagship
    """
    from firmware_model.config.vehicle import load_vehicle
    from gustproof.cli.fly import load_script
    from gustproof.flight.routes.external import ExternalAutopilot, check_external
    from gustproof.show.report.contest import render_comparison
    from gustproof.show.report.terminal import show
    from gustproof.studies.campaign.comparison import compare as fly_all

    script, airframe = load_script(scenario, vehicle, free=free), load_vehicle(vehicle)
    ours = find_law(law, airframe, script.control_rate_hz)
    sets = params or ["stock", "tuned"]
    controllers: list[ExternalAutopilot | Law]
    controllers = [ExternalAutopilot(kind=autopilot, build=build, parameters=each) for each in sets]
    if inside:
        controllers.append(ExternalAutopilot(kind=autopilot, build=inside, law=ours.name))
    check_external(script, autopilot)
    tell_rate(script, autopilot)
    title = f"{script.name}, {runs} seed{'s' if runs > 1 else ''}"
    with progress(title, quiet=as_json) as shown:
        rows = fly_all(script, airframe, [*controllers, ours], range(1, runs + 1), shown)
    if as_json:
        print_json([row.to_dict() for row in rows])
    else:
        show(render_comparison(title, rows))
