"""Options, outputs and progress that commands have in common."""

import json
import math
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from firmware_model.errors import ConfigError
from gustproof.report.figure_style import FigureStyle

if TYPE_CHECKING:
    from firmware_model.config.scenario import Scenario
    from firmware_model.config.vehicle import Vehicle

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON on stdout, and nothing else.")]
Anyway = Annotated[
    bool,
    typer.Option(
        "--anyway", help="Fly even a law that is unstable on the vehicle, or references that it does not hold."
    ),
]
AutopilotName = Annotated[
    str | None,
    typer.Option(
        "--autopilot",
        help="Fly a real autopilot, px4, ardupilot or betaflight, in place of our own.",
        show_default=False,
    ),
]
Build = Annotated[
    str, typer.Option(help="Folder of the autopilot's build [default: the usual places].", show_default=False)
]
Params = Annotated[
    str,
    typer.Option(
        help="Parameters of the autopilot, a file or a shipped set such as tuned, on top of those for the vehicle.",
        show_default=False,
    ),
]
FigureLook = Annotated[
    FigureStyle, typer.Option("--style", help="screen, or paper: 3.5 inches wide, serif, for a column of a paper.")
]
FigureData = Annotated[bool, typer.Option("--data", help="Write the drawn numbers beside the figure (.csv).")]
VehicleName = Annotated[str, typer.Option(help="Name of a shipped vehicle, or a .toml file.")]
SEED = typer.Option(min=0, max=2**32 - 1, help="Seed of gusts and noise.")


def print_json(document: Any) -> None:
    """Print a document of JSON values."""
    print(json.dumps(document, indent=2))


def check_output(path: Path | None, suffix: str | tuple[str, ...], kind: str, *, new: bool = False) -> None:
    """Refuse an output file with none of the suffixes, in no folder or, if it must be `new`, one that exists.

    Raises
    ------
    ConfigError
        If it can't be the output; `None` is no file.
    """
    if path is None:
        return
    suffixes = (suffix,) if isinstance(suffix, str) else suffix
    if path.suffix not in suffixes:
        raise ConfigError(f"{path}: {kind} ends in {' or '.join(suffixes)}")
    if not path.parent.is_dir():
        raise ConfigError(f"{path.parent}: no such folder")
    if new and path.exists():
        raise ConfigError(f"{path}: exists already; nothing is overwritten")


def save_flight(scenario: "Scenario", vehicle: "Vehicle", nominal: "Vehicle", output: Path) -> list[Path]:
    """Write a found flight as a scenario, and its vehicle beside it unless that is the nominal one; return the files.

    The vehicle's file is named after the scenario's, with `-vehicle` at the end.
    """
    from firmware_model.config.files import write_toml

    write_toml(scenario, output)
    if vehicle == nominal:
        return [output]
    beside = output.with_name(f"{output.stem}-vehicle.toml")
    write_toml(vehicle, beside)
    return [output, beside]


def refuse_given(context: typer.Context, names: Iterable[str], why: str) -> None:
    """Refuse parameters on the command line whose values are given elsewhere, or mean nothing there.

    Raises
    ------
    ConfigError
        If one of them is given.
    """
    for name in names:
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            raise ConfigError(f"{why}; '{name.replace('_', '-')}' cannot be given with it")


def parse_positive_vector(option: str, text: str) -> tuple[float, float, float]:
    """Return the three numbers of `text`, written "x,y,z".

    Raises
    ------
    ConfigError
        If they are not three positive, finite numbers.
    """
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise ConfigError(f"{option}: is '{text}', must be three numbers, such as 0.65,0.65,0.3") from None
    if not all(math.isfinite(value) and value > 0.0 for value in (x, y, z)):
        raise ConfigError(f"{option}: is '{text}', every number must be positive and finite")
    return x, y, z


@contextmanager
def progress(title: str, *, quiet: bool) -> Iterator[Callable[[float, str], None]]:
    """Yield a function that shows a fraction [0..1] and a text; silent if `quiet` or if stderr is no terminal."""
    if quiet or not sys.stderr.isatty():
        yield lambda _fraction, _text: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    text, percentage = TextColumn("{task.description}", markup=False), TextColumn("{task.percentage:3.0f} %")
    columns = (text, BarColumn(), percentage, TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as display:
        task = display.add_task(title, total=1.0)
        yield lambda fraction, text: display.update(task, completed=fraction, description=text)
