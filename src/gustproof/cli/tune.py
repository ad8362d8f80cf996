"""The command `gustproof tune`: a law, or an autopilot's gains, for a vehicle."""

import math
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.laws import is_log, read_gains, tell_remarks
from gustproof.cli.options import (
    AsJson,
    FigureData,
    FigureLook,
    Force,
    check_figure,
    check_output,
    complete,
    print_again,
    print_json,
    print_next,
    progress,
    refuse_given,
)
from gustproof.design.structures import BASELINES, LawKind
from gustproof.show.report.figure_style import FigureStyle, figures_as

if TYPE_CHECKING:
    from firmware_model.config.scenario import Scenario
    from firmware_model.config.uncertainty import VehicleSet
    from gustproof.law.form import Law
    from gustproof.logs.read.flight_log import FlightLog


class LawStructure(Enum):
    """Structure of a law: a `LawKind`, or a law of the literature."""

    FLAGSHIP = LawKind.FLAGSHIP.value
    vars().update({name: str(name) for name in (*LawKind, *BASELINES)})


def tune(
    context: typer.Context,
    vehicle: Annotated[
        str, typer.Argument(help="Name of a shipped vehicle, or a .toml file.", autocompletion=complete("vehicle"))
    ],
    law: Annotated[LawStructure, typer.Option(help="Structure of the law.")] = LawStructure.FLAGSHIP,
    slew: Annotated[
        float | None,
        typer.Option(help="Largest rms torque slew [N m/s] [default: 6 times the rms gust moment over the lag]."),
    ] = None,
    ms: Annotated[float, typer.Option(help="Largest sensitivity peak of each axis.")] = 1.4,
    scenario: Annotated[
        str, typer.Option(help="Scenario that gives turbulence, sample rate and delay.")
    ] = "paper-turbulence",
    flown: Annotated[
        str | None,
        typer.Option("--from", help="Tune an autopilot's loops from a log, file, px4 or ardupilot."),
    ] = None,
    at_once: Annotated[bool, typer.Option("--at-once", help="Write the last step, not the first.")] = False,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write the law (.json) or the parameters (.params) here.")
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option(help="Write the law beside the trade-off of error, slew and Ms here (.png, .pdf or .svg)."),
    ] = None,
    style: FigureLook = FigureStyle.SCREEN,
    data: FigureData = False,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Tune a law for a vehicle: the least attitude error in gusts at a torque slew and a sensitivity peak.

    Spreads of inertia and lag are kept, 20 % and 30 % without. The flagship also keeps the margins of a PID, where they
    cost at most 15 % over the least error. Steps of --from are at most 1.5 times in any gain and 2 times in slew. It
    writes the first that is sound, or safer than what flies. Fly it, and start from its log for the next. --at-once is
    for a vehicle in simulation.

        gustproof tune my-quad.toml --slew 7 -o my-law.json --figure my-curve.png

        gustproof tune my-quad.toml --from flight.ulg -o my-quad.params
    """
    from firmware_model.config.files import PARAMETER_SUFFIXES
    from firmware_model.config.scenario import load_scenario
    from firmware_model.config.uncertainty import load_vehicle_set

    is_law = flown is None
    check_output(output, *((".json", "a law file") if is_law else (PARAMETER_SUFFIXES, "a parameter file")))
    check_figure(figure, data=data)
    vehicles, script = load_vehicle_set(vehicle), load_scenario(scenario)
    if flown is None:
        refuse_given(context, ("at_once",), "without --from there are no steps")
        with figures_as(style, data=data):
            _tune_law(law, vehicles, script, slew, ms, output, figure, as_json=as_json)
    else:
        refuse_given(context, ("law", "figure"), "--from tunes the autopilot's own loops")
        start = _read_flown(flown, vehicles)
        _tune_autopilot(start, vehicles, script, slew, ms, output, at_once=at_once, as_json=as_json)
    if not as_json:
        _print_next(context, output, vehicle, flown, ".json" if is_law else PARAMETER_SUFFIXES[0])


def _print_next(context: typer.Context, output: Path | None, vehicle: str, flown: str | None, suffix: str) -> None:
    """Print the judgement of what is written as the next command, or the present one with a file to write."""
    if output is None:
        print_again(context, "-o", Path(vehicle).stem + suffix, without=("figure", "style", "data"))
    else:
        print_next("judge", output, *(() if flown is None else ("--over", flown)), "--vehicle", vehicle)


def _tune_law(
    law: LawStructure,
    vehicles: "VehicleSet",
    script: "Scenario",
    slew: float | None,
    ms: float,
    output: Path | None,
    figure: Path | None,
    *,
    as_json: bool,
) -> None:
    from gustproof.design.literature.tuned import tune_baseline
    from gustproof.design.tune import least_errors, tune_law
    from gustproof.show.report.laws import render_tuning
    from gustproof.show.report.terminal import show

    search = tune_baseline if law.value in BASELINES else tune_law
    with progress("tuning", quiet=as_json) as shown:
        tuning = search(law.value, vehicles, script, slew=slew, sensitivity_peak=ms, progress=shown)
        if figure is not None:
            from gustproof.show.report.figures import save_tuning

            save_tuning(tuning, least_errors(vehicles.nominal, script, tuning), figure)
    if output is not None:
        tuning.law.save(output)
    if as_json:
        print_json(tuning.to_dict())
        return
    show(render_tuning(tuning))
    for kind, path in (("law", output), ("figure", figure)):
        if path is not None:
            print(f"{kind} in {path}")


class _Flown(NamedTuple):
    """Loops to start from."""

    kind: str
    """Autopilot."""
    law: "Law"
    """Loops."""
    log: "FlightLog | None"
    """Log that they are of; `None` for a file of parameters."""


def _read_flown(source: str, vehicles: "VehicleSet") -> _Flown:
    """Return the loops of a file's parameters; tell on stderr what is taken for granted of them.

    Raises
    ------
    ConfigError
        If they are of no autopilot.
    """
    from gustproof.logs.read.read_log import read_log
    from gustproof.studies.rate.advice import autopilot_kind

    log = read_log(Path(source)) if is_log(source) else None
    law, _, remarks = read_gains(source, vehicles.nominal, log=log)
    kind = autopilot_kind(law)
    if kind is None:
        raise ConfigError(f"--from {source}: holds no parameters of PX4 or ArduPilot")
    tell_remarks(law.name, remarks)
    return _Flown(kind, law, log)


def _tune_autopilot(
    start: _Flown,
    vehicles: "VehicleSet",
    script: "Scenario",
    slew: float | None,
    ms: float,
    output: Path | None,
    *,
    at_once: bool,
    as_json: bool,
) -> None:
    from firmware_model.config.firmware import guessed_axes
    from firmware_model.types import AXES
    from gustproof.design.autopilot_gains import save_tuning
    from gustproof.design.tune import wanted_slew
    from gustproof.show.report.gain_steps import render_steps, steps_document
    from gustproof.show.report.terminal import show
    from gustproof.studies.logged_flight import refutation
    from gustproof.studies.rate.filter_tuning import tune_flown
    from gustproof.studies.rate.tuning_steps import describe_choice, describe_filters, first_flyable, plan_steps

    limit = wanted_slew(vehicles.nominal, script, slew, ms)
    with progress(f"tuning {start.kind}", quiet=as_json) as shown:
        tuning, filters = tune_flown(
            start.law, start.log, vehicles, script, slew=limit, sensitivity_peak=ms, progress=shown
        )
        steps = plan_steps(tuning, start.law, vehicles, script, start.log)
    if steps[0].margins is None and start.log is not None and (told := refutation(start.log)):
        raise ConfigError(f"{start.log.source}: the gains that flew are unstable by the model, {told}")
    at = len(steps) - 1 if at_once else first_flyable(steps)
    written = steps[at].tuning
    if output is not None:
        save_tuning(written, vehicles.nominal, output)
    if as_json:
        errors = {"rmse_deg": math.degrees(written.seen_rmse), "true_rmse_deg": math.degrees(written.rmse)}
        figures = {"Ms": written.Ms, "slew": written.slew, **errors}
        document = {"law": tuning.law.name, **figures, "parameters": {**written.parameters, **written.notches}}
        print_json({**document, "filters": filters, "steps": steps_document(steps)})
        return
    show(render_steps(steps, at))
    print(filters)
    remarks = [f"{AXES[axis]}: its gains stay as they fly" for axis in guessed_axes(vehicles.nominal)]
    remarks += written.outside_ranges()
    peaks = written.describe_peaks(vehicles.nominal)
    if steps[0].margins is None:
        remarks.append(
            "the gains that flew are unstable by the model: are they those of the file, and is it the vehicle?"
        )
    remarks += describe_filters(steps, at)
    if not at_once:
        remarks += describe_choice(steps, at)
    tell_remarks(written.law.name, remarks)
    print(f"predicted in {script.name}: {written.describe_error()}, torque slew {written.slew:.3g} N m/s, {peaks}")
    if output is not None:
        print(f"parameters in {output}: step {at} of {len(steps) - 1}")
