"""The command `gustproof tune`: a law, or an autopilot's gains, for a vehicle."""

from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gustproof.cli.laws import PARAMETER_SUFFIXES
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


class LawStructure(Enum):
    """Structure of a law: a `LawKind`, or a law of the literature."""

    FLAGSHIP = LawKind.FLAGSHIP.value
    vars().update({name: str(name) for name in (*LawKind, *BASELINES)})


class TunedAutopilot(Enum):
    """Autopilot whose own loops can be tuned."""

    PX4 = "px4"
    ARDUPILOT = "ardupilot"


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
    autopilot: Annotated[
        TunedAutopilot | None,
        typer.Option("--for", help="Tune this autopilot's own loops, and write its parameters.", show_default=False),
    ] = None,
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

    Spreads of inertia and lag in the vehicle's file are kept, 20 % and 30 % without. The flagship also keeps the
    margins of a PID, as far as they cost no more than 15 % over the least error. The same vehicle has the same law.
    Structures from lqg on are laws of the literature to compare with; px4 and ardupilot are these cascades as laws.

        gustproof tune my-quad.toml --slew 7 -o my-law.json --figure my-curve.png

        gustproof tune my-quad.toml --for px4 -o my-quad.params
    """
    from firmware_model.config.scenario import load_scenario
    from firmware_model.config.uncertainty import load_vehicle_set

    check_output(output, *((".json", "a law file") if autopilot is None else (PARAMETER_SUFFIXES, "a parameter file")))
    check_figure(figure, data=data)
    vehicles, script = load_vehicle_set(vehicle), load_scenario(scenario)
    if autopilot is None:
        with figures_as(style, data=data):
            _tune_law(law, vehicles, script, slew, ms, output, figure, as_json=as_json)
    else:
        refuse_given(context, ("law", "figure"), "--for tunes the autopilot's own loops")
        _tune_autopilot(autopilot, vehicles, script, slew, ms, output, as_json=as_json)
    if output is not None and not as_json:
        print_next("judge", output, "--vehicle", vehicle)
    elif not as_json:
        suffix = ".json" if autopilot is None else PARAMETER_SUFFIXES[0]
        print_again(context, "-o", Path(vehicle).stem + suffix, without=("figure", "style", "data"))


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


def _tune_autopilot(
    autopilot: TunedAutopilot,
    vehicles: "VehicleSet",
    script: "Scenario",
    slew: float | None,
    ms: float,
    output: Path | None,
    *,
    as_json: bool,
) -> None:
    import math

    from gustproof.design.autopilot_gains import save_tuning, tune_gains
    from gustproof.design.tune import wanted_slew

    price = wanted_slew(vehicles.nominal, script, slew, ms)
    with progress(f"tuning {autopilot.value}", quiet=as_json) as shown:
        tuning = tune_gains(autopilot.value, vehicles, script, slew=price, sensitivity_peak=ms, progress=shown)
    if output is not None:
        save_tuning(tuning, vehicles.nominal, output)
    if as_json:
        errors = {"rmse_deg": math.degrees(tuning.seen_rmse), "true_rmse_deg": math.degrees(tuning.rmse)}
        figures = {"Ms": tuning.Ms, "slew": tuning.slew, **errors}
        print_json({"law": tuning.law.name, **figures, "parameters": tuning.parameters})
        return
    for name, value in tuning.parameters.items():
        print(f"{name} {value:g}")
    print(f"predicted: {tuning.describe_error()}, torque slew {tuning.slew:.3g} N m/s, Ms {tuning.Ms:.2f}")
    if output is not None:
        print(f"parameters in {output}")
