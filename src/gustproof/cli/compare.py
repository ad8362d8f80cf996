"""The command `gustproof compare`: real autopilots, their builds and parameters, and laws, flight by flight."""

import sys
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.failures import ExitStatus
from gustproof.cli.flights import tell_rate
from gustproof.cli.laws import find_controller, warn_of_repeated
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
    from firmware_model.config.scenario import Scenario
    from firmware_model.config.vehicle import Vehicle
    from gustproof.design.inside import PriceInside
    from gustproof.flight.controllers.external_autopilot import AnyController
    from gustproof.flight.controllers.user_controller import Controller
    from gustproof.studies.campaign.comparison import ComparisonRow

_PAIR = 2  # autopilots that are compared without a law beside them, unless one is named
_FIGURES = (".png", ".svg", ".pdf")
EQUAL = "equal"
"""Name of the parameters that are tuned to the price of a law inside."""


def compare(
    context: typer.Context,
    scenario: Annotated[
        list[str] | None,
        typer.Argument(
            help="Shipped scenarios, or .toml files; course is 20 that try all [default: paper-turbulence].",
            autocompletion=complete("scenario"),
        ),
    ] = None,
    autopilot: Annotated[str, typer.Option(help="Real autopilot: px4 or ardupilot.")] = "px4",
    build: Annotated[
        list[str] | None, typer.Option(help="Folder of a build; repeat it [default: the usual places].")
    ] = None,
    params: Annotated[
        list[str] | None,
        typer.Option(
            help="Its own loops: a set, a file, or equal, at the price of the law inside; repeat it "
            "[default: equal, stock]."
        ),
    ] = None,
    law: Annotated[
        list[str] | None,
        typer.Option(
            help="Law to fly here: a name, a file, parameters of an autopilot, or your own FILE.py:MAKER or "
            "LIBRARY.so; repeat it [default: flagship].",
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
        typer.Option(
            "-o", "--output", help="Write the table (.md, JUnit .xml), or error over slew (.png, .svg, .pdf)."
        ),
    ] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Fly builds and parameters of a real autopilot, and laws, in the same gusts, and say what is better.

    Each is compared with the first by the error of the same seeds, until that is known to be better, worse or alike:
    within 1 %. The test is read after each seed, and wrong in 1 % of comparisons at most. Of several scenarios the
    geometric mean counts. Ms and delay margin are measured by flights. Two laws need no build, two autopilots no law.
    Exit status: 1 if one is worse than the first, but for stock gains that were not asked for.

        gustproof compare --autopilot px4 --build PX4-Autopilot --inside PX4-with-flagship

        gustproof compare course --law pid-fair --law my_mpc.py:make -o review.md -o junit.xml
    """
    from firmware_model.config.vehicle import load_vehicle
    from gustproof.studies.campaign.comparison import compare as fly_all

    written = _check_tables(output)
    airframe = load_vehicle(vehicle)
    scripts = _find_scenarios(scenario or ["paper-turbulence"], airframe, free=free)
    laws = {each: _find_controller(each, airframe, scripts[0]) for each in _check_once(law or ["flagship"])}
    named: dict[str, AnyController] = {}
    predicted: dict[str, PriceInside] = {}
    with TemporaryDirectory() as folder, progress(scripts[0].name, quiet=as_json) as shown:
        if len(laws) == 1 or _are_given(context):
            first, equal = next(iter(laws.values())), Path(folder) / f"{EQUAL}.params"
            sets = params or _default_sets(first, scripts)
            named = _find_autopilots(autopilot, build, sets, inside, first.name, equal)
            _check_autopilots(scripts, autopilot, [*(build or [""]), *filter(None, [inside])])
            if EQUAL in sets:
                shown(0.0, "gains at an equal price")
                _write_equal(autopilot, first, vehicle, scripts, equal)
            warn_of_repeated(sets, autopilot)
            predicted = _predict(named, first, airframe, scripts)
        _add_laws(named, laws, asked=law is not None)
        rows = fly_all(scripts, airframe, named, range(1, runs + 1), shown, predicted)
    _tell(f"{_name_all(scripts)} on {airframe.name}", rows, written, as_json=as_json)
    if _is_any_worse(rows, but="" if params else f"{autopilot}-stock"):
        raise typer.Exit(ExitStatus.REQUIREMENT_FAILED.value)


def _is_any_worse(rows: "list[ComparisonRow]", but: str) -> bool:
    """Return whether a row is worse than the first, but for those whose names end with `but`, if that is not empty."""
    from gustproof.studies.campaign.paired import Change

    return any(row.change is Change.WORSE for row in rows if not but or not row.name.endswith(but))


def _add_laws(named: "dict[str, AnyController]", laws: "dict[str, Controller]", *, asked: bool) -> None:
    """Add laws by their own names, or by those that they were given if another has the same.

    The default one, which was not `asked` for, is left out beside two autopilots.
    """
    if not asked and len(named) >= _PAIR:
        return
    own = Counter([*named, *(each.name for each in laws.values())])
    named |= {each.name if own[each.name] == 1 else name: each for name, each in laws.items()}


def _name_all(scripts: "list[Scenario]") -> str:
    return scripts[0].name if len(scripts) == 1 else f"{len(scripts)} scenarios"


def _default_sets(law: "Controller", scripts: "list[Scenario]") -> list[str]:
    """Return the sets of parameters that are flown if none is asked for."""
    return [EQUAL, "stock"] if _has_price(law, scripts) else ["stock"]


def _predict(
    named: "dict[str, AnyController]", law: "Controller", vehicle: "Vehicle", scripts: "list[Scenario]"
) -> "dict[str, PriceInside]":
    """Return what the model says of each autopilot's own loops, and of the law inside, in turbulence alone."""
    from firmware_model.config.parameter_files import read_parameters
    from firmware_model.external.versions import read_version
    from gustproof.design.inside import price_inside, price_loops
    from gustproof.errors import DesignError
    from gustproof.flight.controllers.external_autopilot import ExternalAutopilot
    from gustproof.flight.routes.external import find_build
    from gustproof.law.form import Law

    found: dict[str, PriceInside] = {}
    if len(scripts) > 1 or not _is_turbulence_alone(scripts[0]):
        return found  # else it would stand beside flights of something else
    script = _held(scripts[0])
    for name, each in named.items():
        if not isinstance(each, ExternalAutopilot):
            continue
        with suppress(DesignError, ValueError):  # unstable, of rates, or without gusts: nothing is predicted
            if each.law and isinstance(law, Law):
                found[name] = price_inside(each.kind, law, vehicle, script)
            elif not each.law:
                values = read_parameters(each.parameters, each.kind) if each.parameters else {}
                version = read_version(each.kind, find_build(each.kind, Path(each.build) if each.build else None))
                numbers = {key: float(value) for key, value in values.items()}
                found[name] = price_loops(each.kind, numbers, vehicle, script, version)
    return found


def _held(script: "Scenario") -> "Scenario":
    """Return a scenario with the vehicle held and nothing else in it than its air: what the model predicts."""
    return replace(script, translation="held", event=(), require=())


def _is_turbulence_alone(script: "Scenario") -> bool:
    """Return whether nothing but turbulence moves the vehicle."""
    from firmware_model.config.waveforms import RandomGusts

    is_random = all(isinstance(each, RandomGusts) for each in script.wind)
    return is_random and not (script.moment or script.event or script.has_link_script)


def _has_price(law: "Controller", scripts: "list[Scenario]") -> bool:
    """Return whether the price of what flies inside can be had from the model."""
    from firmware_model.config.waveforms import RandomGusts
    from gustproof.law.form import Law, Output

    has_gusts = any(isinstance(each, RandomGusts) for each in scripts[0].wind)
    return isinstance(law, Law) and law.output is Output.TORQUE and has_gusts


def _write_equal(kind: str, law: "Controller", vehicle: str, scripts: "list[Scenario]", path: Path) -> None:
    """Write the best gains of an autopilot's own loops at the price of a law inside, and tell both on stderr.

    Raises
    ------
    ConfigError
        If it is no law of torque, the first scenario has no turbulence, or no such gains are found.
    """
    from firmware_model.config.uncertainty import load_vehicle_set
    from gustproof.design.autopilot_gains import save_tuning
    from gustproof.design.inside import equal_gains
    from gustproof.errors import DesignError
    from gustproof.law.form import Law

    if not isinstance(law, Law) or not _has_price(law, scripts):
        why = f"it takes a law of torque and a scenario with gusts, not {law.name} in {scripts[0].name}"
        raise ConfigError(f"--params {EQUAL}: {why}")
    vehicles = load_vehicle_set(vehicle)
    try:
        price, tuning = equal_gains(kind, law, vehicles, _held(scripts[0]))
    except DesignError as error:
        raise ConfigError(f"--params {EQUAL}: {error}") from None
    save_tuning(tuning, vehicles.nominal, path)
    spent = f"slew {tuning.slew:.3g} of {price.slew:.3g} N m/s, Ms {tuning.Ms:.3g} of {price.Ms:.3g}"
    left = "".join(f"; {each}" for each in tuning.outside_ranges())
    print(f"gustproof: {EQUAL} to {law.name} inside by the model: {spent}{left}", file=sys.stderr)


def _are_given(context: typer.Context) -> bool:
    """Return whether the command line asks for real autopilots."""
    return any(is_given(context, each) for each in ("autopilot", "build", "params", "inside"))


def _check_autopilots(scripts: "list[Scenario]", kind: str, builds: list[str]) -> None:
    """Refuse scenarios that a real autopilot can't fly, and builds that are none; tell the rate of its flights."""
    from gustproof.flight.routes.external import check_external, find_build

    for script in scripts:
        check_external(script, kind)
    for each in builds:
        find_build(kind, Path(each) if each else None)
    tell_rate(scripts[0], kind)


def _check_once(names: list[str]) -> list[str]:
    """Return laws by name; refuse one that is given twice, as its flights would be the same."""
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"--law {name} is given twice")
    return names


def _find_scenarios(names: list[str], vehicle: "Vehicle", *, free: bool) -> "list[Scenario]":
    """Return scenarios by name or file, and those of the course in strengths for the vehicle."""
    from gustproof.cli.fly import load_script
    from gustproof.studies.campaign.course import COURSE, load_course

    found: list[Scenario] = []
    for name in names:
        found += load_course(vehicle) if name == COURSE else [load_script(name, vehicle, free=free)]
    return found


def _find_controller(name: str, airframe: "Vehicle", script: "Scenario") -> "Controller":
    """Return a law by name or file, or a controller of the user's own."""
    from gustproof.flight.controllers.user_controller import ControllerKind, UserController

    found = find_controller(name, airframe, script.control_rate_hz)
    if isinstance(found, UserController) and found.kind is ControllerKind.PROGRAM:
        raise ConfigError(f"--law '{name}': programs fly in `fly` and `worst-case`, here flies what repeats")
    return found


def _check_tables(output: list[Path] | None) -> list[Path]:
    """Return the tables and figures to write; refuse one that can't be written."""
    for path in output or ():
        check_output(path, (".md", ".xml", *_FIGURES), "a table or figure")
    return output or []


def _tell(title: str, rows: "list[ComparisonRow]", output: list[Path], *, as_json: bool) -> None:
    """Write the tables, and print one."""
    from firmware_model.config.files import write_text
    from gustproof.show.report.contest import render_comparison, render_junit, render_markdown
    from gustproof.show.report.terminal import show

    for path in output:
        if path.suffix in _FIGURES:
            from gustproof.show.report.figures import save_comparison

            save_comparison(title, rows, path)
            continue
        write_text(path, (render_markdown if path.suffix == ".md" else render_junit)(title, rows))
    if as_json:
        print_json([row.to_dict() for row in rows])
    else:
        show(render_comparison(title, rows))


def _find_autopilots(
    kind: str, builds: list[str] | None, sets: list[str], inside: str, law: str, equal: Path
) -> "dict[str, AnyController]":
    """Return each build with each set of parameters, then the build with a law inside, by names that tell them apart.

    The gains at an equal price are those of the file `equal`.

    Raises
    ------
    ConfigError
        If one is given twice.
    """
    from gustproof.flight.controllers.external_autopilot import ExternalAutopilot

    found: dict[str, AnyController] = {}
    builds = builds or [""]
    for build, parameters in product(builds, sets):
        each = ExternalAutopilot(kind=kind, build=build, parameters=str(equal) if parameters == EQUAL else parameters)
        if each in found.values():
            raise ConfigError(f"compare: {build or kind} with {parameters} is given twice")
        name = f"{Path(build).name}: {each.name}" if len(builds) > 1 else each.name
        found[name if name not in found else f"{build}: {parameters}"] = each
    if inside:
        each = ExternalAutopilot(kind=kind, build=inside, law=law)
        found[each.name] = each
    return found
