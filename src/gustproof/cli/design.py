"""The command `gustproof design`: from weights to a law file."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from enum import Enum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from firmware_model.errors import ConfigError
from gustproof.cli.options import (
    AsJson,
    FigureData,
    FigureLook,
    check_output,
    complete,
    print_json,
    progress,
    refuse_given,
    working,
)
from gustproof.report.figure_style import SUFFIXES, FigureStyle

if TYPE_CHECKING:
    from gustproof.model.rotational import Envelope
    from gustproof.synthesis.derive import Solver
    from gustproof.synthesis.designs import Design
    from gustproof.synthesis.structured.goals import Goal


class Method(Enum):
    """Synthesis method of a design."""

    HINFSYN = "hinfsyn"  # two Riccati equations: the central controller, of the plant's order
    H2SYN = "h2syn"  # two Riccati equations: the least rms of the weighted outputs for white noise
    HINFSTRUCT = "hinfstruct"  # nonsmooth optimisation: any order, each axis on its own
    NCFSYN = "ncfsyn"  # loop shaping: the widest margin of coprime factors at a crossover
    MUSYN = "musyn"  # D-K iteration: the L2 gain over an envelope
    LPV = "lpv"  # linear matrix inequalities: the L2 gain over an envelope, scheduled on attitude and rates


_OWN_OPTIONS = {
    "gamma": {Method.HINFSYN},
    "backoff": {Method.HINFSYN, Method.NCFSYN, Method.LPV},
    "inner": {Method.HINFSYN},
    "order": {Method.HINFSTRUCT},
    "starts": {Method.HINFSTRUCT},
    "seed": {Method.HINFSTRUCT},
    "decay": {Method.HINFSTRUCT},
    "max_gain": {Method.HINFSTRUCT},
    "crossover": {Method.NCFSYN},
    "angle": {Method.HINFSTRUCT, Method.MUSYN, Method.LPV},
    "rate": {Method.HINFSTRUCT, Method.MUSYN, Method.LPV},
}
"""Methods that take an option; all take those that are not here."""


def design(
    context: typer.Context,
    name: Annotated[
        str,
        typer.Argument(
            help="Name of a shipped design, such as D1, or a .toml file.",
            autocompletion=complete("design", "list", "show"),
        ),
    ],
    gamma: Annotated[float | None, typer.Option(help="hinfsyn: level to design for.")] = None,
    backoff: Annotated[
        float | None, typer.Option(help="hinfsyn, ncfsyn, lpv: level as a multiple (> 1) of the least possible level.")
    ] = None,
    vehicle: Annotated[
        str | None,
        typer.Option(
            help="Name of a shipped vehicle, or a .toml file [default: the design's].",
            autocompletion=complete("vehicle"),
        ),
    ] = None,
    method: Annotated[
        Method,
        typer.Option(
            help="Central (hinfsyn), least rms for white noise (h2syn), fixed order (hinfstruct), loop shaping (ncfsyn)"
            ", D-K iteration (musyn) or scheduled on attitude and rates (lpv)."
        ),
    ] = Method.HINFSYN,
    order: Annotated[
        int | None, typer.Option(help="hinfstruct: states of the controller, the same number for each axis: 3, 6, 9...")
    ] = None,
    starts: Annotated[int, typer.Option(min=1, help="hinfstruct: number of starts of the search.")] = 5,
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="hinfstruct: seed of random starts.")] = 1,
    decay: Annotated[
        float | None, typer.Option(help="hinfstruct: least decay of every pole of the closed loop [1/s].")
    ] = None,
    max_gain: Annotated[
        float | None,
        typer.Option(help="hinfstruct: largest singular value of the controller's matrix [A, B; C, D], |K|."),
    ] = None,
    crossover: Annotated[float, typer.Option(help="ncfsyn: crossover of the shaped loop [rad/s].")] = 20.0,
    angle: Annotated[
        float | None, typer.Option("--angle-rad", help="musyn, lpv, hinfstruct: largest roll and pitch [rad].")
    ] = None,
    rate: Annotated[
        float | None, typer.Option("--rate-rad-s", help="musyn, lpv, hinfstruct: largest rates p, q, r [rad/s].")
    ] = None,
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
    """Solve a design, print its level, norm, checks, order, margins and poles, and save the law.

    The law is flown, certified, analysed and exported like any other. Methods differ in what they make small:

    - hinfsyn and hinfstruct: the H-infinity norm of the weighted loop at hover; hinfstruct with an envelope: the
    worst one for attitudes and rates that are constant within it.

    - h2syn: its H2 norm, the rms of the weighted outputs for white noise.

    - ncfsyn: the norm for errors of the plant's coprime factors. The loop crosses 1 at --crossover and holds the
    attitude below a sixth of it; the design's weights have no part in it.

    - musyn: the L2 gain of the weighted loop for all motions within an envelope, proved in exact arithmetic.

    - lpv: the same for a controller that is scheduled: on its own estimate of roll and pitch and the measured rates, as
    far as the envelope. Its proof takes their estimate as exact.

    With --decay and --max-gain hinfstruct finds the least norm among the controllers that keep these bounds.

    The law of a scheduled design is linear with ncfsyn and musyn: their states are no estimates of the attitude.

        gustproof design D1

        gustproof design D2 --gamma 0.25 -o my-law.json

        gustproof design D2 --figure d2.pdf --style paper --data

        gustproof design D2 --method hinfstruct --order 6 -o reduced.json

        gustproof design D2 --method ncfsyn --crossover 15 -o shaped.json

        gustproof design D2 --method musyn --angle-rad 0.3 --rate-rad-s 0.5 -o wide.json

        gustproof design D2 --method lpv --angle-rad 0.3 --rate-rad-s 0.5 -o scheduled.json

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

    _check_options(context, method, gamma, backoff)
    if inner is not None and gamma is not None:
        raise ConfigError("--inner sets the level itself: do not give --gamma")
    check_output(output, ".json", "a law file")
    check_output(figure, SUFFIXES, "a figure")
    wanted = load_design(name)
    if gamma is not None:
        wanted = replace(wanted, gamma=gamma)
    elif backoff is not None:
        wanted = replace(wanted, gamma=None, backoff=backoff)
    airframe = None if vehicle is None else load_vehicle(vehicle)
    with progress(f"design {wanted.name}", quiet=as_json) as shown:
        if inner is not None:
            law, report = derive_over(wanted, load_inner_loops(inner), airframe)
        else:
            wanted, solve = _choose_solver(method, wanted, context.params, shown)
            law, report = derive(wanted, airframe, solve=solve)
    if output is not None:
        law.save(output)
        figure = figure or output.with_suffix(".png")
    if figure is not None:
        with working(f"drawing {figure}", quiet=as_json), figures_as(style, data=data):
            save_design_figure(report, figure)
    if as_json:
        print_json({**report.to_dict(), "method": method.value})
        return
    show(render_design(report))
    if told := ", ".join(_files(output, figure)):
        print(told)


def _files(law: Path | None, figure: Path | None) -> Iterator[str]:
    """Yield what stands in the written files."""
    for what, path in (("law", law), ("singular values", figure)):
        if path is not None:
            yield f"{what} in {path}"


def _choose_solver(
    method: Method, wanted: "Design", options: dict[str, Any], shown: Callable[[float, str], None]
) -> "tuple[Design, Solver | None]":
    """Return the design as far as a method can serve it, and its solver with its own options."""
    from gustproof.synthesis import methods
    from gustproof.synthesis.structured.fixed_order import solve_structured

    if method is Method.HINFSTRUCT:
        own = {name: options[name] for name in ("order", "starts", "seed")}
        own["hard_goals"] = tuple(_bounds(options["decay"], options["max_gain"]))
        reduced = methods.named_for("hinfstruct", wanted, estimates=True)
        return reduced, partial(solve_structured, **own, progress=shown, envelope=_parse_envelope(options))
    if method is Method.H2SYN:
        return methods.named_for("h2syn", wanted, estimates=True), methods.solve_h2
    if method is Method.NCFSYN:
        crossover = options["crossover"]
        if not 0.0 < crossover < math.inf:
            raise ConfigError(f"--crossover: is {crossover}, must be positive")
        shaped = methods.named_for("ncfsyn", wanted, estimates=False)
        return shaped, partial(methods.solve_loop_shaping, crossover=crossover)
    if method in (Method.MUSYN, Method.LPV):
        envelope = _parse_envelope(options)
        if envelope is None:
            raise ConfigError(f"--method {method.value} needs --angle-rad and --rate-rad-s")
        solve = methods.solve_mu if method is Method.MUSYN else methods.solve_lpv
        robust = methods.named_for(method.value, wanted, estimates=False)
        return robust, partial(solve, envelope=envelope, progress=shown)
    return wanted, None


def _bounds(decay: float | None, max_gain: float | None) -> "Iterator[Goal]":
    """Yield the hard goals of the options."""
    from gustproof.synthesis.structured.goals import ControllerSizeGoal, DecayGoal

    for option, value in (("--decay", decay), ("--max-gain", max_gain)):
        if value is not None and not 0.0 < value < math.inf:
            raise ConfigError(f"{option}: is {value}, must be positive")
    if decay is not None:
        yield DecayGoal(minimum=decay)
    if max_gain is not None:
        yield ControllerSizeGoal(limit=max_gain)


def _parse_envelope(options: dict[str, Any]) -> "Envelope | None":
    """Return the envelope of attitudes and rates; `None` without it."""
    from gustproof.model.rotational import Envelope

    angle, rate = options["angle"], options["rate"]
    if angle is None and rate is None:
        return None
    if angle is None or rate is None:
        raise ConfigError("--angle-rad and --rate-rad-s go together")
    try:
        return Envelope(angle=angle, rate=rate)
    except ValueError as error:
        raise ConfigError(str(error)) from None


def _check_options(context: typer.Context, method: Method, gamma: float | None, backoff: float | None) -> None:
    if gamma is not None and backoff is not None:
        raise ConfigError("--gamma and --backoff both set the level: give one of them")
    if (gamma is not None and not 0.0 < gamma < math.inf) or (backoff is not None and not backoff > 1.0):
        raise ConfigError("--gamma must be above 0 and finite, --backoff above 1")
    foreign = sorted(option for option, methods in _OWN_OPTIONS.items() if method not in methods)
    refuse_given(context, foreign, f"--method {method.value} has no use for it")
    if method is Method.HINFSTRUCT and context.params["order"] is None:
        raise ConfigError("--method hinfstruct needs --order")
