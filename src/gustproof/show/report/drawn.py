"""Figures of results that draw themselves, for notebooks; files of them are `gustproof.show.report.figures`."""

from functools import singledispatch
from typing import Any

from matplotlib.figure import Figure

from gustproof.flight.recording.flown import FlownRecords
from gustproof.flight.routes.flight import Flight
from gustproof.show.report.figures import draw_analysis, draw_distributions, draw_histories
from gustproof.show.report.terminal import FIGURES
from gustproof.studies.campaign.reader import open_table, read_column
from gustproof.studies.campaign.statistics import CampaignStatistics
from gustproof.studies.rate.analyse import Analysis
from gustproof.types import Records


@singledispatch
def draw(result: Any, *others: Any, **options: Any) -> Figure:
    """Return the figure of a result, with others of its kind in the same axes.

    Raises
    ------
    TypeError
        If there is no figure of such a thing.
    """
    raise TypeError(f"no figure of a {type(result).__name__}")


@draw.register(FlownRecords)
@draw.register(Flight)
def _(result: FlownRecords | Flight, *others: FlownRecords | Flight, kind: str = "euler-angles") -> Figure:
    flights: dict[str, Records] = {}
    for each in (result, *others):
        name, records = (each.pilot_name, each.records) if isinstance(each, Flight) else (each.name, each)
        flights[name if name not in flights else f"{name} ({len(flights) + 1})"] = records
    return draw_histories(kind, flights, result.scenario.name if isinstance(result, Flight) else ", ".join(flights))


@draw.register
def _(result: Analysis) -> Figure:
    return draw_analysis(result)


@draw.register
def _(result: CampaignStatistics, *figures: str) -> Figure:
    campaign, file = result.campaign, open_table(result.table)
    values = {
        f"{FIGURES[name][0]} [{FIGURES[name][1]}]": dict(
            zip((law.law for law in result.laws), read_column(file, name, campaign), strict=True)
        )
        for name in figures or ("rmse_deg", "peak_deg")
    }
    return draw_distributions(f"{campaign.scenario.name}: {campaign.cases:,} cases", values)
