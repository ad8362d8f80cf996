"""The command `gustproof compare`: real autopilots, their builds and parameters, and laws, flight by flight."""

from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.failures import ExitStatus
from gustproof.cli.flights import tell_rate
from gustproof.cli.laws import LAW_HELP, find_law
from gustproof.cli.options import (
    AsJson,
    Force,
    VehicleName,
    check_output,
    complete,
    is_given,
    print_json,
    progress,
)

if TYPE_CHECKING:
    from gustproof.flight.routes.external import ExternalAutopilot
    from gustproof.law.form import Law
    from gustproof.studies.campaign.comparison import ComparisonRow


def compare(
    context: typer.Context,
    scenario: Annotated[
        str, typer.Argument(help="Name of a shipped scenario, or a .toml file.", autocompletion=complete("scenario"))
    ] = "paper-turbulence",
    autopilot: Annotated[str, typer.Option(help="Real autopilot: px4 or ardupilot.")] = "px4",
    build: Annotated[
        list[str] | None, typer.Option(help="Folder of a build; repeat it [default: the usual places].")
    ] = None,
    params: Annotated[
        list[str] | None,
        typer.Option(help="Parameters of its own loops, a shipped set or a file; repeat it [default: stock, tuned]."),
    ] = None,
    law: Annotated[
        list[str] | None,
        typer.Option(
            help=f"Law to fly here, beside them or alone; repeat it. {LAW_HELP} [default: flagship].",
            autocompletion=complete("law"),
        ),
    ] = None,
    inside: Annotated[
        str, typer.Option(help="Build with the first law inside, made by gustproof export [default: none].")
    ] = "",
    runs: Annotated[int, typer.Option(min=1, max=1000, help="Most seeds 1, 2, … of each.")] = 20,
    free: Annotated[bool, typer.Option("--free", help="Fly free, even if the scenario holds the vehicle.")] = False,
    vehicle: VehicleName = "paper",
    output: Annotated[
        list[Path] | None,
        typer.Option("-o", "--output", help="Write the table here: Markdown (.md) or JUnit (.xml); repeat it."),
    ] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Fly builds and parameters of a real autopilot, and laws, in the same gusts, and say what is better.

    Each is compared with the first by the error of the same seeds, until that is known to be better, worse or alike:
    within 1 %. The test is read after each flight, and wrong in 1 % of comparisons at most. Two laws alone need no
    build. Exit status: 1 if one is worse than the first.

        gustproof compare paper-turbulence --autopilot px4 --build PX4-Autopilot --inside PX4-with-flagship

        gustproof compare paper-turbulence --law flagship --law my-law.json -o review.md -o junit.xml
    """
    from firmware_model.config.vehicle import load_vehicle
    from gustproof.cli.fly import load_script
    from gustproof.flight.routes.external import check_external
    from gustproof.studies.campaign.comparison import compare as fly_all
    from gustproof.studies.campaign.paired import Change

    written = _check_tables(output)
    script, airframe = load_script(scenario, vehicle, free=free), load_vehicle(vehicle)
    laws = {each: find_law(each, airframe, script.control_rate_hz) for each in _check_once(law or ["flagship"])}
    named: dict[str, ExternalAutopilot | Law] = {}
    if len(laws) == 1 or any(is_given(context, each) for each in ("autopilot", "build", "params", "inside")):
        first = next(iter(laws.values())).name
        named = _find_autopilots(autopilot, build, params, inside, first)
        check_external(script, autopilot)
        tell_rate(script, autopilot)
    for name, each in laws.items():
        named[each.name if each.name not in named else name] = each
    title = f"{script.name} on {airframe.name}"
    with progress(title, quiet=as_json) as shown:
        rows = fly_all(script, airframe, named, range(1, runs + 1), shown)
    _tell(title, rows, written, as_json=as_json)
    if any(row.change is Change.WORSE for row in rows):
        raise typer.Exit(ExitStatus.REQUIREMENT_FAILED.value)


def _check_once(names: list[str]) -> list[str]:
    """Return laws by name; refuse one that is given twice, as its flights would be the same."""
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"--law {name} is given twice")
    return names


def _check_tables(output: list[Path] | None) -> list[Path]:
    """Return the tables to write; refuse one that can't be written."""
    for path in output or ():
        check_output(path, (".md", ".xml"), "a table")
    return output or []


def _tell(title: str, rows: "list[ComparisonRow]", output: list[Path], *, as_json: bool) -> None:
    """Write the tables, and print one."""
    from firmware_model.config.files import write_text
    from gustproof.show.report.contest import render_comparison, render_junit, render_markdown
    from gustproof.show.report.terminal import show

    for path in output:
        write_text(path, (render_markdown if path.suffix == ".md" else render_junit)(title, rows))
    if as_json:
        print_json([row.to_dict() for row in rows])
    else:
        show(render_comparison(title, rows))


def _find_autopilots(
    kind: str, builds: list[str] | None, sets: list[str] | None, inside: str, law: str
) -> "dict[str, ExternalAutopilot | Law]":
    """Return each build with each set of parameters, then the build with a law inside, by names that tell them apart.

    Raises
    ------
    ConfigError
        If one is given twice.
    """
    from gustproof.flight.routes.external import ExternalAutopilot

    found: dict[str, ExternalAutopilot | Law] = {}
    builds = builds or [""]
    for build, parameters in product(builds, sets or ["stock", "tuned"]):
        each = ExternalAutopilot(kind=kind, build=build, parameters=parameters)
        if each in found.values():
            raise ConfigError(f"compare: {build or kind} with {parameters} is given twice")
        name = f"{Path(build).name}: {each.name}" if len(builds) > 1 else each.name
        found[name if name not in found else f"{build}: {parameters}"] = each
    if inside:
        each = ExternalAutopilot(kind=kind, build=inside, law=law)
        found[each.name] = each
    return found
