"""Statistics of a campaign: figures with confidence intervals, pass rates, worst runs, importance, comparisons."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.requirement import Requirement
from gustproof.flight.recording.flown import Tabled
from gustproof.flight.routes.flight import warnings
from gustproof.law.form import Law
from gustproof.studies.campaign.intervals import (
    CONFIDENCE,
    Importance,
    IntervalEstimate,
    Ranking,
    importance,
    mean,
    proportion,
    quantile,
    rank_values,
)
from gustproof.studies.campaign.plan import Campaign
from gustproof.studies.campaign.reader import open_table, read_campaign, read_column
from gustproof.studies.campaign.worker import FIGURES, delta_column, requirement_columns
from gustproof.types import Array

if TYPE_CHECKING:
    import pyarrow

QUANTILES = {"median": 0.5, "p95": 0.95, "p99": 0.99}
"""Quantiles computed for each figure, by name."""
COMPARED_FIGURES = ("rmse_deg", "peak_deg", "torque_rms_nm", "torque_slew_rms")
"""Figures in which laws are compared case by case."""
IMPORTANCE_NOTE = (
    "rank_correlation: Spearman's; first_order: Sobol' index by binning, no effect distinguishable up to 'noise'"
)
"""Definition of importance."""
_WORST_COUNT = 5

Indices = NDArray[np.intp]


class WorstRun(NamedTuple):
    """A run with one of the largest values of a figure."""

    run: int
    """Number of the run."""
    value: float
    """[unit of the figure] value in this run."""


class FailedRun(NamedTuple):
    """A run without figures."""

    run: int
    """Number of the run."""
    reason: str
    """Reason of the failure."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FigureStatistics:
    """One figure over the runs of a law, unit as in `Metrics`."""

    flown: int
    """Number of runs with this figure."""
    mean: IntervalEstimate
    """Mean of the figure."""
    quantiles: dict[str, IntervalEstimate]
    """Quantiles by the names of `QUANTILES`."""
    worst: tuple[WorstRun, ...]
    """Runs with the largest values, the worst first."""
    importance: dict[str, Importance | None]
    """Effect of each dispersion, by name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PassRate:
    """One requirement over the runs of a law."""

    requirement: Requirement
    """Requirement of the scenario."""
    rate: IntervalEstimate
    """[-] share of the runs that met it."""
    worst: tuple[WorstRun, ...]
    """Runs farthest beyond the limit, or nearest to it; the worst first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LawStatistics:
    """Statistics of the runs of one law."""

    law: str
    """Name of the law."""
    figures: dict[str, FigureStatistics]
    """Figures by name."""
    passed: tuple[PassRate, ...]
    """Pass rates of the scenario's requirements."""
    all_held: IntervalEstimate
    """[-] share of the runs that have figures and met all requirements."""
    failures: tuple[FailedRun, ...]
    """First few runs without figures."""
    failed: int
    """Number of runs without figures."""
    tilted: int
    """Number of runs tilted past 90 deg."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LawComparison:
    """Comparison of two laws over the same cases."""

    figure: str
    """Name of the figure."""
    law: str
    """Name of the first law."""
    other: str
    """Name of the second law."""
    lower: IntervalEstimate
    """[-] share of the cases in which the figure of `law` is below that of `other`."""
    difference: IntervalEstimate
    """[unit of the figure] mean over the cases of the figure of `law` less that of `other`."""
    effect: float
    """[-] J. Cohen's d_z, 1988: the difference over the standard deviation of the differences; NaN if all are equal."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class CampaignStatistics(Tabled):
    """Statistics of a campaign; `plot` draws the distributions of RMSE and peak, or of the figures that are named."""

    table: Path
    """File of the campaign."""
    campaign: Campaign
    """Scenario, laws and dispersions."""
    laws: tuple[LawStatistics, ...]
    """Statistics of each law."""
    duels: tuple[LawComparison, ...]
    """Comparison of each pair of laws, in each of `COMPARED_FIGURES`."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the laws on the nominal vehicle and in their flights, one line each; read them first."""
        flown = self.campaign
        laws = (law for law in flown.laws if isinstance(law, Law))
        known = (line for law in laws for line in warnings(flown.scenario, law, flown.vehicles.nominal))
        tilted = (
            f"'{found.law}' tilted past 90 deg in {found.tilted} of {flown.cases} runs"
            for found in self.laws
            if found.tilted
        )
        return (*known, *tilted)

    def lines(self) -> list[str]:
        """Return the median and the 95th percentile of error and slew, with intervals, and what failed, by law."""
        campaign, shown = self.campaign, (("RMSE", "rmse_deg", "deg"), ("slew", "torque_slew_rms", "N m/s"))
        lines = [f"{campaign.scenario.name}, vehicle {campaign.vehicles.nominal.name}: {campaign.cases:,} cases"]
        for found in self.laws:
            for label, name, unit in shown:
                median, high = (found.figures[name].quantiles[each] for each in ("median", "p95"))
                lines.append(
                    f"{found.law}, {label}: median {median.value:.3g} ({median.low:.3g} to {median.high:.3g}), "
                    f"95th percentile {high.value:.3g} ({high.low:.3g} to {high.high:.3g}) {unit}"
                )
            lines += [f"{found.law}, failed: {found.failed} runs"] if found.failed else []
        return [*lines, *(f"warning: {line}" for line in self.warnings)]

    def to_arrow(self) -> "pyarrow.Table":
        """Return the rows of the campaign, one a run, units by their names."""
        return open_table(self.table).read()

    def to_dict(self) -> dict[str, Any]:
        """Return the statistics as JSON values; numbers that are not finite become null."""
        campaign = self.campaign
        return {
            "table": str(self.table),
            "scenario": campaign.scenario.name,
            "vehicle": campaign.vehicles.document["name"],
            "runs": campaign.runs,
            "cases": campaign.cases,
            "seed": campaign.seed,
            "sampling": campaign.sampling.value,
            "spreads": _to_json(campaign.spreads),
            "warnings": list(self.warnings),
            "confidence": CONFIDENCE,
            "importance": IMPORTANCE_NOTE,
            "laws": {found.law: _to_json(found) for found in self.laws},
            "duels": _to_json(self.duels),
        }


def _to_json(value: Any) -> Any:
    """Return any part of the statistics as JSON values."""
    if isinstance(value, Enum):
        return value.value
    if is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    elif hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {key: _to_json(item) for key, item in value.items()}
    if isinstance(value, tuple):
        return [_to_json(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def compute_statistics(path: Path) -> CampaignStatistics:
    """Return the statistics of the campaign in a file; memory holds one column and the dispersions of one law.

    Raises
    ------
    ConfigError
        If the file is no campaign's table.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from gustproof import Campaign, compute_statistics, fly_campaign, process_pool
    >>> from gustproof import load_law, load_scenario, load_vehicle_set
    >>> plan = Campaign(
    ...     scenario=replace(load_scenario("paper-turbulence"), duration_s=0.5), laws=(load_law("pid-fair"),),
    ...     vehicles=load_vehicle_set("paper"), spreads={}, cases=64,
    ... )
    >>> with TemporaryDirectory() as folder, process_pool(1) as pool:
    ...     fly_campaign(plan, Path(folder) / "mc.parquet", pool)
    ...     found = compute_statistics(Path(folder) / "mc.parquet")
    >>> found.laws[0].failed
    0
    """
    campaign, table = read_campaign(path), open_table(path)
    laws = tuple(_summarize_law(table, campaign, number) for number in range(len(campaign.laws)))
    compared = [name for name in FIGURES if name in COMPARED_FIGURES]
    duels = tuple(
        duel for name in compared for duel in _compare_laws(name, read_column(table, name, campaign), campaign)
    )
    return CampaignStatistics(table=path, campaign=campaign, laws=laws, duels=duels)


def _summarize_figures(table: Any, campaign: Campaign, number: int) -> dict[str, FigureStatistics]:
    flown = np.flatnonzero(np.isfinite(read_column(table, FIGURES[0], campaign)[number]))
    deltas = {
        name: rank_values(read_column(table, delta_column(name), campaign)[number][flown]) for name in campaign.spreads
    }
    first = number * campaign.cases
    return {
        name: _summarize_figure(read_column(table, name, campaign)[number], flown, first, deltas) for name in FIGURES
    }


def _summarize_figure(values: Array, flown: Indices, first: int, deltas: dict[str, Ranking]) -> FigureStatistics:
    found = values[flown]
    if not len(found):
        unknown = IntervalEstimate(math.nan, -math.inf, math.inf)
        return FigureStatistics(
            flown=0, mean=unknown, quantiles=dict.fromkeys(QUANTILES, unknown), worst=(), importance={}
        )
    order, ranks = rank_values(found)
    return FigureStatistics(
        flown=len(found),
        mean=mean(found),
        quantiles={name: quantile(found[order], p) for name, p in QUANTILES.items()},
        worst=_worst_runs(values, first, values),
        importance={name: importance(delta, found, ranks) for name, delta in deltas.items()},
    )


def _worst_runs(values: Array, first: int, keys: Array) -> tuple[WorstRun, ...]:
    """Return the runs from `first` on with the largest keys; a NaN key does not count."""
    falling = np.where(np.isnan(keys), math.inf, -keys)
    last = min(_WORST_COUNT, len(falling)) - 1
    among = np.flatnonzero(falling <= np.partition(falling, last)[last])  # to sort all takes far longer
    order = among[np.argsort(falling[among], kind="stable")][:_WORST_COUNT]
    return tuple(WorstRun(first + int(i), float(values[i])) for i in order if not math.isnan(keys[i]))


def _summarize_law(table: Any, campaign: Campaign, number: int) -> LawStatistics:
    cases, first = campaign.cases, number * campaign.cases
    passed = []
    for requirement, name in zip(
        campaign.scenario.require, requirement_columns(campaign.scenario.require), strict=True
    ):
        held = int(read_column(table, f"{name}_held", campaign)[number].sum())
        values = read_column(table, name, campaign)[number]
        above = -math.inf if requirement.at_most is None else values - requirement.at_most
        below = -math.inf if requirement.at_least is None else requirement.at_least - values
        worst = _worst_runs(values, first, np.maximum(above, below))  # by the excess over the nearer limit
        passed.append(PassRate(requirement=requirement, rate=proportion(held, cases), worst=worst))
    reasons = table.read(columns=["failure"]).column(0).slice(first, cases)
    failed = np.flatnonzero(reasons.is_valid().to_numpy())
    return LawStatistics(
        law=campaign.laws[number].name,
        figures=_summarize_figures(table, campaign, number),
        passed=tuple(passed),
        all_held=proportion(int(read_column(table, "held", campaign)[number].sum()), cases),
        failures=tuple(FailedRun(first + int(i), reasons[int(i)].as_py()) for i in failed[:_WORST_COUNT]),
        failed=len(failed),
        # The angle passes 90 deg exactly where the rotors point below the horizon; pitch never does.
        tilted=int(np.count_nonzero(read_column(table, "peak_roll_deg", campaign)[number] > 90.0)),
    )


def _compare_laws(figure: str, values: Array, campaign: Campaign) -> Iterator[LawComparison]:
    for one, other in combinations(range(len(campaign.laws)), 2):
        both = np.isfinite(values[one]) & np.isfinite(values[other])
        if both.any():
            differences = values[one][both] - values[other][both]
            spread = float(np.std(differences, ddof=1)) if len(differences) > 1 else 0.0
            difference = mean(differences)
            yield LawComparison(
                figure=figure,
                law=campaign.laws[one].name,
                other=campaign.laws[other].name,
                lower=proportion(int(np.count_nonzero(differences < 0.0)), len(differences)),
                difference=difference,
                effect=difference.value / spread if spread > 0.0 else math.nan,
            )
