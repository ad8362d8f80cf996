"""The command `gustproof design`: from weights to a law file."""

from collections.abc import Iterator
from dataclasses import replace
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.options import AsJson, FigureData, FigureLook, check_output, print_json, progress
from gustproof.report.figure_style import SUFFIXES, FigureStyle


class Method(Enum):
    """Synthesis method of a design."""

    HINFSYN = "hinfsyn"  # two Riccati equations: the central controller, of the plant's order
    HINFSTRUCT = "hinfstruct"  # nonsmooth optimisation: any order, each axis on its own


def design(
    name: Annotated[str, typer.Argument(help="Name of a shipped design, such as D1, or a .toml file.")],
    gamma: Annotated[float | None, typer.Option(help="Level to design for.")] = None,
    backoff: Annotated[
        float | None, typer.Option(help="Level as a multiple (> 1) of the least possible level.")
    ] = None,
    vehicle: Annotated[
        str | None, typer.Option(help="Name of a shipped vehicle, or a .toml file [default: the design's].")
    ] = None,
    method: Annotated[
        Method, typer.Option(help="hinfsyn: a controller of the plant's order; hinfstruct: one of the given --order.")
    ] = Method.HINFSYN,
    order: Annotated[
        int | None, typer.Option(help="hinfstruct: states of the controller, the same number for each axis: 3, 6, 9...")
    ] = None,
    starts: Annotated[int, typer.Option(min=1, help="hinfstruct: number of starts of the search.")] = 5,
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="hinfstruct: seed of random starts.")] = 1,
    inner: Annotated[
        Path | None,
        typer.Option(help="Rate loops of the autopilot, from `identify-rates`, for a law that sends rates."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write the law here (.json), its singular values beside it.")
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option(help="Write the singular values here (.png, .pdf or .svg) [default: beside the law, as PNG]."),
    ] = None,
    style: FigureLook = FigureStyle.SCREEN,
    data: FigureData = False,
    as_json: AsJson = False,
) -> None:
    """Solve an H-infinity design, print its level, norm, order, margins and poles, and save the law.

    gustproof design D1

    gustproof design D2 --gamma 0.25 -o my-law.json

    gustproof design D2 --figure d2.pdf --style paper --data

    gustproof design D2 --method hinfstruct --order 6 -o reduced.json

    gustproof design R1 --inner my-px4.toml -o my-rates.json
    """
    from firmware_model.config.vehicle import load_vehicle
    from gustproof.report.figure_style import figures_as
    from gustproof.report.laws import render_design, save_design_figure
    from gustproof.report.terminal import show
    from gustproof.synthesis.derive import derive
    from gustproof.synthesis.designs import load_design
    from gustproof.synthesis.inner_loops import load_inner_loops
    from gustproof.synthesis.rate_law import derive_over
    from gustproof.synthesis.structured.fixed_order import solve_structured

    _check_method(method, order, gamma, backoff)
    if inner is not None and (order is not None or gamma is not None):
        raise ConfigError("--inner sets the level and the controller's order itself: give neither --gamma nor --order")
    check_output(output, ".json", "a law file")
    check_output(figure, SUFFIXES, "a figure")
    wanted = load_design(name)
    if gamma is not None:
        wanted = replace(wanted, gamma=gamma)
    elif backoff is not None:
        wanted = replace(wanted, gamma=None, backoff=backoff)
    airframe = None if vehicle is None else load_vehicle(vehicle)
    with progress(f"searching, {wanted.name}", quiet=as_json or order is None) as shown:
        search = partial(solve_structured, order=order or 0, starts=starts, seed=seed, progress=shown)
        if inner is not None:
            law, report = derive_over(wanted, load_inner_loops(inner), airframe)
        else:
            law, report = derive(wanted, airframe, solve=None if order is None else search)
    if output is not None:
        law.save(output)
        figure = figure or output.with_suffix(".png")
    if figure is not None:
        with figures_as(style, data=data):
            save_design_figure(report, figure)
    if as_json:
        print_json(report.to_dict())
        return
    show(render_design(report))
    if told := ", ".join(_files(output, figure)):
        print(told)


def _files(law: Path | None, figure: Path | None) -> Iterator[str]:
    """Yield what stands in the written files."""
    for what, path in (("law", law), ("singular values", figure)):
        if path is not None:
            yield f"{what} in {path}"


def _check_method(method: Method, order: int | None, gamma: float | None, backoff: float | None) -> None:
    if gamma is not None and backoff is not None:
        raise ConfigError("--gamma and --backoff both set the level: give one of them")
    if (gamma is not None and not gamma > 0.0) or (backoff is not None and not backoff > 1.0):
        raise ConfigError("--gamma must be above 0, --backoff above 1")
    if (method is Method.HINFSTRUCT) != (order is not None):
        raise ConfigError("--method hinfstruct and --order go together")
    if method is Method.HINFSTRUCT and (gamma is not None or backoff is not None):
        raise ConfigError("--method hinfstruct minimises the level: --gamma and --backoff cannot set it")
