"""Options, outputs and progress that commands have in common."""

import json
import math
import os
import shlex
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib.resources import files
from itertools import chain, count, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from firmware_model.config.validation import printable
from firmware_model.config.whole_file import OVERWRITES, check_folder
from firmware_model.errors import ConfigError
from gustproof.show.report.figure_style import SUFFIXES, FigureStyle

if TYPE_CHECKING:
    from firmware_model.config.scenario import Scenario
    from firmware_model.config.vehicle import Vehicle

COMPILING = ": compiling the simulator, once after an installation"
"""End of a line of progress while machine code is made."""
_FIRST_LINE_S, _NEXT_LINES_S = 2.0, 10.0  # between lines that say what goes on, where there is no terminal
_OUTPUTS = ("-o", "--better", "--px4", "--ardupilot", "--crazyflie")  # options that name what a command writes
_SHIPPED = {  # the packages whose folders hold the names of each kind; read without loading what they hold
    "law": ("gustproof.law", "data"),
    "design": ("gustproof.design", "data"),
    "vehicle": ("firmware_model.config", "data/vehicles"),
    "scenario": ("firmware_model.config", "data/scenarios"),
}


def complete(kind: str, *words: str) -> Callable[[str], list[str]]:
    """Return what completes a shipped name of a kind, or one of some words, for a shell; files it knows itself."""
    package, folder = _SHIPPED[kind]

    def names(incomplete: str) -> list[str]:
        paths = (Path(path.name) for path in files(package).joinpath(folder).iterdir())
        known = {path.stem for path in paths if path.suffix in (".json", ".toml")}
        return sorted(name for name in known | set(words) if name.startswith(incomplete))

    return names


def _allow_overwriting(*, wanted: bool) -> bool:
    OVERWRITES.set(wanted)
    return wanted


Force = Annotated[
    bool,
    typer.Option("--force", help="Overwrite files that exist.", callback=_allow_overwriting),
]
"""An option that acts by itself: all that writes files heeds it. Each command that writes has it."""
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON on stdout, and nothing else.")]
Anyway = Annotated[
    bool,
    typer.Option("--anyway", help="Fly even a law that is unstable there, or can't hold the references."),
]
AutopilotName = Annotated[
    str | None,
    typer.Option(
        "--autopilot",
        help="Fly a real px4, ardupilot or betaflight.",
        show_default=False,
    ),
]
Build = Annotated[str, typer.Option(help="Folder of its build [default: the usual places].", show_default=False)]
Params = Annotated[
    str,
    typer.Option(
        help="Parameters of the autopilot: a file, or a shipped set such as tuned.",
        show_default=False,
    ),
]
FigureLook = Annotated[
    FigureStyle, typer.Option("--style", help="screen, or paper: 3.5 inches wide, serif, for a column of a paper.")
]
FlightBegin = Annotated[float | None, typer.Option("--from", help="Begin of the flight in the log [s], if not told.")]
FlightEnd = Annotated[float | None, typer.Option("--to", help="End of the flight in the log [s], if not told.")]
FigureData = Annotated[bool, typer.Option("--data", help="Write the drawn numbers beside the figure (.csv).")]
VehicleName = Annotated[
    str, typer.Option(help="A shipped vehicle, or a .toml file.", autocompletion=complete("vehicle"))
]


Number = TypeVar("Number", int, float)


def in_range(low: float, high: float | None = None) -> Callable[[Number | None], Number | None]:
    """Return what refuses a number outside a range; typer's own ranges take half the width of a help."""

    def check(value: Number | None) -> Number | None:
        if value is not None and not low <= value <= (value if high is None else high):
            raise typer.BadParameter(f"{value} is not in the range x>={low}" + f" and x<={high}" * (high is not None))
        return value

    return check


SEED = typer.Option(callback=in_range(0, 2**32 - 1), help="Seed of gusts and noise.")


def print_json(document: Any) -> None:
    """Print a document of JSON values; numbers that are not finite, which JSON does not have, become null."""
    from pydantic_core import to_jsonable_python

    print(json.dumps(to_jsonable_python(document, inf_nan_mode="null"), indent=2, allow_nan=False))


def print_next(*words: object) -> None:
    """Print the command that comes next on the road from a log to the board; it writes no file that is there."""
    told = [_free(Path(str(word))) if before in _OUTPUTS else word for before, word in pairwise(("gustproof", *words))]
    told = [f"./{word}" if isinstance(word, Path) and str(word).startswith("-") else word for word in told]  # no option
    print("next: " + printable(shlex.join(["gustproof", *map(str, told)])))


def _free(path: Path) -> Path:
    """Return a path at which nothing is: this one, or one with a number behind its name."""
    paths = (path.with_name(f"{path.stem}-{number}{path.suffix}") for number in count(2))
    return next(each for each in chain([path], paths) if not os.path.lexists(each))


def print_again(context: typer.Context, *words: object, without: Iterable[str] = ()) -> None:
    """Print the present command again as the next one, with `words` added; it writes no other file a second time.

    Options of outputs, which exist by now, and of `without` are left out.
    """
    said: list[object] = []
    level: Any = context
    while level.parent:  # the root has the program's name, which may be that of an interpreter
        said, level = [level.info_name, *said], level.parent
    for each in context.command.params:
        value = context.params.get(each.name or "")
        if not is_given(context, each.name or "") or each.name in {"as_json", "force", "output", *without}:
            continue
        flags = [*each.opts[:1]] if each.param_type_name == "option" else []
        said += flags if value is True else [*flags, getattr(value, "value", value)]
    print_next(*said, *words)


def check_output(path: Path | None, suffix: str | tuple[str, ...], kind: str) -> None:
    """Refuse an output file with none of the suffixes, in no folder, or one that exists unless `Force` is given.

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
    check_parent(path)
    if path.is_dir():
        raise ConfigError(f"{path}: is a folder")
    if os.path.lexists(path) and not OVERWRITES.get():
        raise ConfigError(f"{path}: exists already; --force overwrites it")


def check_parent(path: Path) -> None:
    """Refuse an output in no folder: a folder by a slip of the pen would be lost among others.

    Raises
    ------
    ConfigError
        If there is no such folder.
    """
    if not path.parent.is_dir():
        raise ConfigError(f"{path.parent}: no such folder")


def check_folder_output(path: Path) -> None:
    """Refuse an output folder in no folder, or one with files unless `Force` is given.

    Raises
    ------
    ConfigError
        If it can't be the output.
    """
    check_parent(path)
    check_folder(path)


def check_figure(path: Path | None, *, data: bool) -> None:
    """Refuse a figure as `check_output` does, and the file of its numbers if `data` is wanted.

    Raises
    ------
    ConfigError
        If one of them can't be the output.
    """
    check_output(path, SUFFIXES, "a figure")
    if path is not None and data:
        check_output(path.with_suffix(".csv"), ".csv", "its numbers")


def flight_files(output: Path) -> tuple[Path, Path]:
    """Return the files of a found flight: its scenario, and its vehicle named after that."""
    return output, output.with_name(f"{output.stem}-vehicle.toml")


def save_flight(scenario: "Scenario", vehicle: "Vehicle", nominal: "Vehicle", output: Path) -> list[Path]:
    """Write a found flight as a scenario, and its vehicle beside it unless it is the nominal one; return the files."""
    from firmware_model.config.files import write_toml

    _, beside = flight_files(output)
    write_toml(scenario, output)
    if vehicle == nominal:
        return [output]
    write_toml(vehicle, beside)
    return [output, beside]


def is_given(context: typer.Context, name: str) -> bool:
    """Return whether a parameter is on the command line."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def refuse_given(context: typer.Context, names: Iterable[str], why: str) -> None:
    """Refuse parameters on the command line whose values are given elsewhere, or mean nothing there.

    Raises
    ------
    ConfigError
        If one of them is given.
    """
    written = {parameter.name: max(parameter.opts, key=len) for parameter in context.command.params}
    for name in names:
        if is_given(context, name):
            raise ConfigError(f"{why}; {written[name]} cannot be given with it")


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
def progress(
    title: str | Callable[[], str], *, quiet: bool, at_once: bool = True
) -> Iterator[Callable[[float, str], None]]:
    """Yield a function that shows a fraction [0..1] and a text on stderr; where that is no terminal, as plain lines.

    The bar moves, and lines come, also while the function is not called: a thread sees to it, from the first call on if
    not `at_once`. If `quiet` there are none. A title that is costly to find is a function, which a quick command never
    calls.
    """
    if quiet:
        yield lambda _fraction, _text: None
    elif sys.stderr.isatty():
        with _bar(title if isinstance(title, str) else title(), total=1.0, at_once=at_once) as shown:
            yield shown
    else:
        with _plain_lines(title, at_once=at_once) as shown:
            yield shown


@contextmanager
def working(title: str, *, quiet: bool) -> Iterator[None]:
    """Show on stderr that work of unknown length goes on, and for how long; nothing if `quiet`."""
    if quiet:
        yield
        return
    with _bar(title, total=None, at_once=True) if sys.stderr.isatty() else _plain_lines(title, at_once=True):
        yield


def _tell_compiling(line: str) -> str:
    """Return a line of progress that says so while this process makes machine code."""
    numerics = sys.modules.get("firmware_model.numerics.compiled")  # imported by what flies, not here
    return line + COMPILING if numerics and numerics.is_compiling() and COMPILING not in line else line


@contextmanager
def _bar(title: str, *, total: float | None, at_once: bool) -> Iterator[Callable[[float, str], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.text import Text

    class Description(TextColumn):
        def render(self, task: Any) -> Text:
            return Text(_tell_compiling(task.description))

    text, percentage = Description(""), TextColumn("{task.percentage:3.0f} %")
    known = () if total is None else (percentage, TimeRemainingColumn())
    display = Progress(text, BarColumn(), TimeElapsedColumn(), *known, console=Console(stderr=True), transient=True)
    task = display.add_task(printable(title), total=total)

    def show(fraction: float, text: str) -> None:
        display.start()
        display.update(task, completed=fraction, description=printable(text))

    if at_once:
        display.start()
    try:
        yield show
    finally:
        display.stop()


@contextmanager
def _plain_lines(title: str | Callable[[], str], *, at_once: bool) -> Iterator[Callable[[float, str], None]]:
    """Yield as `progress` does; a thread prints the latest state after 2 s, and from then on every 10 s."""
    latest: list[tuple[float, str | Callable[[], str]]] = [(0.0, title)]
    ended, start = threading.Event(), time.monotonic()

    def repeat() -> None:
        wait_s = _FIRST_LINE_S
        while not ended.wait(wait_s):
            (fraction, text), wait_s = latest[0], _NEXT_LINES_S
            share, shown = f"{fraction:.0%}, " if fraction else "", text if isinstance(text, str) else text()
            print(
                f"gustproof: {_tell_compiling(printable(shown))}: {share}{time.monotonic() - start:.0f} s",
                file=sys.stderr,
                flush=True,
            )

    thread = threading.Thread(target=repeat, daemon=True)

    def show(fraction: float, text: str) -> None:
        latest[0] = fraction, text
        if thread.ident is None:
            thread.start()

    if at_once:
        thread.start()
    try:
        yield show
    finally:
        ended.set()
        if thread.ident is not None:
            thread.join()
