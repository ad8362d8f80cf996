"""Table of real autopilots and laws side by side."""

from collections.abc import Iterable

from rich.table import Table
from rich.text import Text

from gustproof.show.report.terminal import Renderable, format_number
from gustproof.studies.campaign.comparison import ComparisonRow

_HEADINGS = (
    "RMSE, means removed [deg]",
    "RMSE [deg]",
    "RMSE as it sees it [deg]",
    "torque slew [N m/s]",
    "speed [x real time]",
)


def render_comparison(title: str, rows: Iterable[ComparisonRow]) -> Renderable:
    """Return the table, a row for each controller."""
    table = Table("", title=title)
    for heading in _HEADINGS:
        table.add_column(heading, justify="right")
    for row in rows:
        figures = row.steady_rmse_deg, row.rmse_deg, row.own_rmse_deg, row.torque_slew_rms, row.realtime_factor
        table.add_row(Text(row.name), *("" if figure is None else format_number(figure) for figure in figures))
    return table
