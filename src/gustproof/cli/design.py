"""The commands `gustproof design`: from weights to a law file, one for each method of synthesis."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from firmware_model.config.validation import printable
from firmware_model.errors import ConfigError
from gustproof.cli.options import (
    SEED,
    AsJson,
    FigureData,
    FigureLook,
    Force,
    check_figure,
    check_output,
    complete,
    in_range,
    print_json,
    progress,
    working,
)
from gustproof.show.report.figure_style import FigureStyle

if TYPE_CHECKING:
    from gustproof.airframe.rotational import Envelope
    from gustproof.design.derive import Solver
    from gustproof.design.designs import Design
    from gustproof.robust.structured.goals import Goal

design = typer.Typer(no_args_is_help=True, help="Solve an H-infinity design, or list and show the shipped ones.")

_DesignName = Annotated[
    str,
    typer.Argument(
        help="A shipped design, such as D1, or a .toml file.", autocompletion=complete("design"), show_default=False
    ),
]
_Vehicle = Annotated[
    str | None,
    typer.Option(
        help="A shipped vehicle, or a .toml file [default: the design's].", autocompletion=complete("vehicle")
    ),
]
_Output = Annotated[Path | None, typer.Option("-o", "--output", help="Write the law here (.json).")]
_Figure = Annotated[
    Path | None,
    typer.Option(help="Write singular values here (.png, .pdf or .svg) [default: beside the law]."),
]
_Backoff = Annotated[float | None, typer.Option(help="Level as a multiple (> 1) of the least possible level.")]
_ANGLE = typer.Option("--angle-rad", help="Envelope: largest roll and pitch [rad].")
_RATE = typer.Option("--rate-rad-s", help="Envelope: largest rates p, q, r [rad/s].")
_Progress = Callable[[float, str], None]


class _Outputs(NamedTuple):
    """Files that a design writes, and the form in which it is shown."""

    law: Path | None
    """File of the law."""
    figure: Path | None
    """File of its singular values; `None` for one beside the law."""
    style: FigureStyle
    """Look of the figure."""
    data: bool
    """True to write the drawn numbers too."""
    as_json: bool
    """True to print JSON."""


@design.command()
def hinfsyn(
    name: _DesignName,
    gamma: Annotated[float | None, typer.Option(help="Level to design for [default: the design's].")] = None,
    backoff: _Backoff = None,
    inner: Annotated[
        Path | None,
        typer.Option(help="Rate loops of the autopilot, from `identify --connect`, for a law that sends rates."),
    ] = None,
    vehicle: _Vehicle = None,
    output: _Output = None,
    figure: _Figure = None,
    style: FigureLook = FigureStyle.SCREEN,
    data: FigureData = False,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Solve two Riccati equations: the central controller of the H-infinity norm at hover, of the plant's order.

    gustproof design hinfsyn D2 --gamma 0.25 -o my-law.json
    gustproof design hinfsyn R1 --inner my-px4.toml -o my-rates.json
    """
    if gamma is not None and backoff is not None:
        raise ConfigError("--gamma and --backoff both set the level: give one of them")
    if gamma is not None and not 0.0 < gamma < math.inf:
        raise ConfigError("--gamma must be above 0 and finite")
    if inner is not None and gamma is not None:
        raise ConfigError("--inner sets the level itself: do not give --gamma")
    outputs = _check_outputs(output, figure, style, data=data, as_json=as_json)
    wanted = _load(name, backoff)
    if gamma is not None:
        wanted = replace(wanted, gamma=gamma)
    _derive("hinfsyn", wanted, vehicle, outputs, lambda _: None, inner)


@design.command()
def h2syn(
    name: _DesignName,
    vehicle: _Vehicle = None,
    output: _Output = None,
    figure: _Figure = None,
    style: FigureLook = FigureStyle.SCREEN,
    data: FigureData = False,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Solve two Riccati equations: the least rms of the weighted outputs for white noise, the H2 norm.

    gustproof design h2syn D2 -o quiet.json
    """
    from gustproof.design import methods

    outputs = _check_outputs(output, figure, style, data=data, as_json=as_json)
    wanted = methods.named_for("h2syn", _load(name), estimates=True)
    _derive("h2syn", wanted, vehicle, outputs, lambda _: methods.solve_h2)


@design.command()
def hinfstruct(
    name: _DesignName,
    order: Annotated[int, typer.Argument(help="States, the same number for each axis: 3, 6, 9...")],
    starts: Annotated[int, typer.Option(callback=in_range(1), help="Number of starts of the search.")] = 5,
    seed: Annotated[int, SEED] = 1,
    keep: Annotated[
        str,
        typer.Option(
            help="Bounds to keep: decay=D, the least of every pole of the loop [1/s]; max-gain=K, the largest singular "
            "value of the controller's matrix [A, B; C, D].",
            show_default=False,
        ),
    ] = "",
    angle: Annotated[float | None, _ANGLE] = None,
    rate: Annotated[float | None, _RATE] = None,
    vehicle: _Vehicle = None,
    output: _Output = None,
    figure: _Figure = None,
    style: FigureLook = FigureStyle.SCREEN,
    data: FigureData = False,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Search a controller of fewer states, each axis on its own: the least H-infinity norm, nonsmooth.

    With an envelope it is the worst norm for attitudes and rates that are constant within it.

        gustproof design hinfstruct D2 6 -o reduced.json
        gustproof design hinfstruct D2 6 --keep "decay=0.02, max-gain=50" -o bounded.json
    """
    from gustproof.design import methods
    from gustproof.design.fixed_order import solve_structured

    outputs = _check_outputs(output, figure, style, data=data, as_json=as_json)
    own: dict[str, Any] = {"order": order, "starts": starts, "seed": seed}
    own |= {"hard_goals": _parse_bounds(keep), "envelope": _parse_given_envelope(angle, rate)}
    wanted = methods.named_for("hinfstruct", _load(name), estimates=True)
    _derive("hinfstruct", wanted, vehicle, outputs, lambda shown: partial(solve_structured, **own, progress=shown))


@design.command()
def ncfsyn(
    name: _DesignName,
    crossover: Annotated[float, typer.Option(help="Crossover of the shaped loop [rad/s].")] = 20.0,
    backoff: _Backoff = None,
    vehicle: _Vehicle = None,
    output: _Output = None,
    figure: _Figure = None,
    style: FigureLook = FigureStyle.SCREEN,
    data: FigureData = False,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Shape the loop: the widest margin for errors of the plant's coprime factors at a crossover.

    The loop crosses 1 at --crossover and holds the attitude below a sixth of it; the design's weights have no part in
    it.

        gustproof design ncfsyn D2 --crossover 15 -o shaped.json
    """
    from gustproof.design import methods

    if not 0.0 < crossover < math.inf:
        raise ConfigError(f"--crossover: is {crossover}, must be positive")
    outputs = _check_outputs(output, figure, style, data=data, as_json=as_json)
    wanted = methods.named_for("ncfsyn", _load(name, backoff), estimates=False)
    _derive("ncfsyn", wanted, vehicle, outputs, lambda _: partial(methods.solve_loop_shaping, crossover=crossover))


@design.command()
def musyn(
    name: _DesignName,
    angle: Annotated[float, _ANGLE],
    rate: Annotated[float, _RATE],
    vehicle: _Vehicle = None,
    output: _Output = None,
    figure: _Figure = None,
    style: FigureLook = FigureStyle.SCREEN,
    data: FigureData = False,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Iterate D and K: the L2 gain for all motions within an envelope, proved in exact arithmetic.

    gustproof design musyn D2 --angle-rad 0.3 --rate-rad-s 0.5 -o wide.json
    """
    from gustproof.design import methods

    outputs = _check_outputs(output, figure, style, data=data, as_json=as_json)
    wanted = methods.named_for("musyn", _load(name), estimates=False)
    envelope = _parse_envelope(angle, rate)
    _derive(
        "musyn", wanted, vehicle, outputs, lambda shown: partial(methods.solve_mu, envelope=envelope, progress=shown)
    )


@design.command()
def lpv(
    name: _DesignName,
    angle: Annotated[float, _ANGLE],
    rate: Annotated[float, _RATE],
    backoff: _Backoff = None,
    vehicle: _Vehicle = None,
    output: _Output = None,
    figure: _Figure = None,
    style: FigureLook = FigureStyle.SCREEN,
    data: FigureData = False,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Solve matrix inequalities: the L2 gain over an envelope, scheduled on attitude and rates.

    The law is scheduled on its own estimate of roll and pitch and the measured rates, as far as the envelope. Its proof
    takes the estimate as exact.

        gustproof design lpv D2 --angle-rad 0.3 --rate-rad-s 0.5 -o scheduled.json
    """
    from gustproof.design import methods

    outputs = _check_outputs(output, figure, style, data=data, as_json=as_json)
    wanted = methods.named_for("lpv", _load(name, backoff), estimates=False)
    envelope = _parse_envelope(angle, rate)
    _derive(
        "lpv", wanted, vehicle, outputs, lambda shown: partial(methods.solve_lpv, envelope=envelope, progress=shown)
    )


def _load(name: str, backoff: float | None = None) -> "Design":
    """Return a design, with the level at a multiple of the least if `backoff` is given."""
    from gustproof.design.designs import load_design

    if backoff is None:
        return load_design(name)
    if not backoff > 1.0:
        raise ConfigError("--backoff must be above 1")
    return replace(load_design(name), gamma=None, backoff=backoff)


def _check_outputs(law: Path | None, figure: Path | None, style: FigureStyle, *, data: bool, as_json: bool) -> _Outputs:
    check_output(law, ".json", "a law file")
    figure = figure or (law and law.with_suffix(".png"))
    check_figure(figure, data=data)
    return _Outputs(law, figure, style, data, as_json)


def _derive(
    method: str,
    wanted: "Design",
    vehicle: str | None,
    outputs: _Outputs,
    solver: "Callable[[_Progress], Solver | None]",
    inner: Path | None = None,
) -> None:
    """Solve a design by a method, write law and figure, and print its level, norm, checks, order, margins and poles."""
    from firmware_model.config.vehicle import load_vehicle
    from gustproof.design.derive import derive
    from gustproof.design.inner_loops import load_inner_loops
    from gustproof.design.rate_law import derive_over
    from gustproof.show.report.figure_style import figures_as
    from gustproof.show.report.laws import render_design, save_design_figure
    from gustproof.show.report.terminal import show

    airframe = None if vehicle is None else load_vehicle(vehicle)
    with progress(f"design {wanted.name}", quiet=outputs.as_json) as shown:
        if inner is not None:
            law, report = derive_over(wanted, load_inner_loops(inner), airframe)
        else:
            law, report = derive(wanted, airframe, solve=solver(shown))
    if outputs.law is not None:
        law.save(outputs.law)
    if outputs.figure is not None:
        drawing = working(f"drawing {outputs.figure}", quiet=outputs.as_json)
        with drawing, figures_as(outputs.style, data=outputs.data):
            save_design_figure(report, outputs.figure)
    if outputs.as_json:
        print_json({**report.to_dict(), "method": method})
        return
    show(render_design(report))
    written = (("law", outputs.law), ("singular values", outputs.figure))
    if names := ", ".join(f"{what} in {path}" for what, path in written if path is not None):
        print(names)


def _parse_bounds(keep: str) -> "tuple[Goal, ...]":
    """Return the hard goals that words as `decay=0.02, max-gain=50` ask for."""
    from gustproof.robust.structured.goals import ControllerSizeGoal, DecayGoal

    goals: dict[str, Callable[[float], Goal]] = {
        "decay": lambda value: DecayGoal(minimum=value),
        "max-gain": lambda value: ControllerSizeGoal(limit=value),
    }
    found = {}
    for word in filter(None, map(str.strip, keep.split(","))):
        name, _, number = map(str.strip, word.partition("="))
        if name not in goals or name in found:
            raise ConfigError(f"--keep: '{printable(word)}' is not one decay=D or max-gain=K")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not 0.0 < value < math.inf:
            raise ConfigError(f"--keep: {name} is '{printable(number)}', must be a positive number")
        found[name] = goals[name](value)
    return tuple(found.values())


def _parse_envelope(angle: float, rate: float) -> "Envelope":
    """Return the envelope of attitudes [rad] and rates [rad/s]."""
    from gustproof.airframe.rotational import Envelope

    try:
        return Envelope(angle=angle, rate=rate)
    except ValueError as error:
        raise ConfigError(str(error)) from None


def _parse_given_envelope(angle: float | None, rate: float | None) -> "Envelope | None":
    """Return the envelope; `None` without it."""
    if angle is None and rate is None:
        return None
    if angle is None or rate is None:
        raise ConfigError("--angle-rad and --rate-rad-s go together")
    return _parse_envelope(angle, rate)
