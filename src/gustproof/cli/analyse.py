"""The command `gustproof analyse`: performance and limits of a law."""

from pathlib import Path
from typing import Annotated

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.laws import LAW_HELP, find_law, on_vehicle
from gustproof.cli.options import (
    SEED,
    AsJson,
    FigureData,
    FigureLook,
    Force,
    VehicleName,
    check_figure,
    complete,
    print_json,
    working,
)
from gustproof.show.report.figure_style import FigureStyle


def analyse(
    law: Annotated[str, typer.Argument(help=LAW_HELP, autocompletion=complete("law"))],
    scenario: Annotated[
        str, typer.Option(help="Scenario that gives the wind and the sample rate.")
    ] = "paper-turbulence",
    vehicle: VehicleName = "paper",
    seed: Annotated[int, SEED] = 1,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="Write Bode plot, sensitivities, mu, step and gust response here (.png, .pdf, .svg or .pgf).",
        ),
    ] = None,
    panels: Annotated[
        str,
        typer.Option(
            help="Panels of the figure: loop, sensitivity, phase, mu, spreads, step, torque, gust; in a paper the "
            "first two and the last. [default: all]",
            show_default=False,
        ),
    ] = "",
    style: FigureLook = FigureStyle.SCREEN,
    data: FigureData = False,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Print a law's margins, poles, flown figures, error budget and limits.

    gustproof analyse hinf-scheduled -o hinf-scheduled.png

    gustproof analyse hinf-scheduled -o loop.pdf --style paper --panels loop,gust --data

    gustproof analyse mine.mat --vehicle iris --json
    """
    from firmware_model.config.scenario import load_scenario
    from firmware_model.config.vehicle import load_vehicle
    from gustproof.law.references import describe_other_rate
    from gustproof.show.report.laws import render_analysis
    from gustproof.show.report.terminal import show
    from gustproof.studies.rate.analyse import analyse as analysed
    from gustproof.studies.rate.law_margins import axis_robustness_over_frequency

    check_figure(output, data=data)
    airframe = load_vehicle(vehicle)
    script = on_vehicle(load_scenario(scenario), airframe)
    read = find_law(law, airframe, script.control_rate_hz)
    if line := describe_other_rate(script, read.name, read.dt):
        raise ConfigError(line)
    try:
        with working(f"analysing {read.name}", quiet=as_json):
            analysis = analysed(read, airframe, script, seed=seed)
        if output is not None:
            from gustproof.show.report.figure_style import figures_as
            from gustproof.show.report.figures import save_analysis

            with figures_as(style, data=data):
                chosen = [name.strip() for name in panels.split(",") if name.strip()]
                save_analysis(analysis, axis_robustness_over_frequency(read, airframe, script), output, chosen=chosen)
    except (ValueError, OverflowError) as error:  # numbers beyond a matrix routine or an axis
        raise ConfigError(f"law '{read.name}' cannot be analysed on vehicle '{airframe.name}': {error}") from None
    if as_json:
        print_json(analysis.to_dict())
        return
    show(render_analysis(analysis))
    if output is not None:
        print(f"figure in {output}")
