"""Look and files of figures: PNG, PDF, SVG or PGF, for the screen or a paper's column, with their numbers as CSV."""

import csv
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from enum import Enum
from io import BytesIO, StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from firmware_model.config.whole_file import whole_file, write_files
from firmware_model.errors import ConfigError
from gustproof.show.report.spreadsheet import quote_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SUFFIXES = (".png", ".pdf", ".svg", ".pgf")
"""Suffixes of figures."""
_MOST_POINTS = 2000  # of a curve beside a figure: more than a column has dots
_COLUMN_IN = 3.5  # width of a column in a journal of two columns
_PAPER: Any = {
    "font.family": "serif",
    "mathtext.fontset": "dejavuserif",
    "font.size": 7.0,
    "axes.linewidth": 0.5,
    "lines.markersize": 3.0,
    "xtick.major.width": 0.5,
    "ytick.major.width": 0.5,
}
_FILES: Any = {"pdf.fonttype": 42, "svg.hashsalt": "gustproof", "svg.fonttype": "none"}
_NO_DATE: dict[str, dict[str, Any]] = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}


class FigureStyle(Enum):
    """Look of a figure."""

    SCREEN = "screen"  # with a title, in landscape
    PAPER = "paper"  # 3.5 inches wide, serif, without a title: a column's caption has it


class _Output(NamedTuple):
    style: FigureStyle = FigureStyle.SCREEN
    data: bool = False
    suffix: str | None = None


_SCREEN = _Output()
_OUTPUT: ContextVar[_Output] = ContextVar("figure_output", default=_SCREEN)


@contextmanager
def figures_as(style: FigureStyle, *, data: bool = False, suffix: str | None = None) -> Iterator[None]:
    """Draw all figures in `style`, and write the drawn numbers beside each as CSV if `data` is wanted.

    A `suffix` takes the place of that of each file.

    Raises
    ------
    ConfigError
        If it is that of PGF, and there is no TeX installation.
    """
    from matplotlib import rc_context

    _check_format(suffix)
    token = _OUTPUT.set(_Output(style, data, suffix))
    try:
        with rc_context(_FILES | (_PAPER if style is FigureStyle.PAPER else {})):
            yield
    finally:
        _OUTPUT.reset(token)


def is_paper() -> bool:
    """Return whether a column of a paper is drawn."""
    return _OUTPUT.get().style is FigureStyle.PAPER


def font_size(points: float) -> float:
    """Return a font's size [pt]: as given on a screen, that of the column in a paper."""
    return min(points, 7.0) if is_paper() else points


def legend_columns() -> int:
    """Return the number of columns of a legend below a figure."""
    return 3 if is_paper() else 4  # as long as their names are, in eight inches


def new_figure(size: tuple[float, float], title: str, *, colour: str) -> "Figure":
    """Return a figure of `size` [in]; in a paper as wide as a column, and without a title."""
    from gustproof.show.report.laid_out import LaidOutFigure

    if is_paper():
        return LaidOutFigure(figsize=(_COLUMN_IN, min(_COLUMN_IN * size[1] / size[0] * 1.15, 9.0)))
    figure = LaidOutFigure(figsize=size)
    figure.suptitle(title, fontsize=12, color=colour)
    return figure


def panels(figure: "Figure", rows: int, columns: int, **shared: Any) -> list["Axes"]:
    """Return axes row by row; in a paper below each other, with 1.4 inches each."""
    if is_paper() and columns > 1:
        rows, columns = rows * columns, 1
        figure.set_size_inches(_COLUMN_IN, min(1.4 * rows + 0.4, 9.5))
    return [*figure.subplots(rows, columns, squeeze=False, **shared).ravel()]


def save_figure(figure: "Figure", path: Path) -> None:
    """Write a figure in the format of the file's suffix, and its numbers beside it if they are wanted.

    Raises
    ------
    ConfigError
        If the format is PGF and there is no TeX installation, or the file can't be written.
    """
    from matplotlib import rc_context

    path = path.with_suffix(_OUTPUT.get().suffix or path.suffix)
    _check_format(path.suffix)
    drawn = BytesIO()  # a writer of pictures hides the reason of a full disk
    with rc_context(_FILES):
        dots = 300 if is_paper() else 150
        figure.savefig(drawn, dpi=dots, format=path.suffix[1:], metadata=_NO_DATE.get(path.suffix))
    with whole_file(path) as file:
        file.write(drawn.getbuffer())
    if _OUTPUT.get().data and any(axes.lines for axes in figure.axes):
        save_data(figure, path.with_suffix(".csv"))


def _check_format(suffix: str | None) -> None:
    from matplotlib import rcParams

    program = rcParams["pgf.texsystem"]
    if suffix == ".pgf" and shutil.which(program) is None:
        raise ConfigError(f"figures as .pgf need a TeX installation, whose {program} measures text; .pdf needs none")


def save_data(figure: "Figure", path: Path) -> None:
    """Write the curves of a figure: panel, curve, label of x, label of y, x, y in each row.

    Of a long curve, as of a flight, the lowest and the highest sample of each section are written.
    """
    import numpy as np

    from gustproof.show.report.thinned import decimate

    with StringIO(newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(("panel", "curve", "x_label", "y_label", "x", "y"))
        for number, axes in enumerate(figure.axes):
            labels = axes.xaxis.get_label_text(), axes.yaxis.get_label_text()
            for line in axes.lines:
                if line.get_transform() != axes.transData:  # across the panel, no curve
                    continue
                name = str(line.get_label())
                named = "" if name.startswith("_") else name
                x, y = np.asarray(line.get_xydata(), dtype=float).T
                points = zip(*decimate(x, y, _MOST_POINTS), strict=True)
                table.writerows((number + 1, *map(quote_text, (named, *labels)), *point) for point in points)
        write_files({path: stream.getvalue()})
