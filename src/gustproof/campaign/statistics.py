"""What came of a campaign: figures with their confidence, pass rates, worst runs, what matters, who is better."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.requirement import Requirement
from gustproof.campaign.intervals import (
    LEVEL,
    Estimate,
    Importance,
    Ranked,
    importance,
    mean,
    quantile,
    ranked,
    share,
)
from gustproof.campaign.plan import Campaign
from gustproof.campaign.reader import opened, read_campaign, read_column
from gustproof.campaign.sampling import Array
from gustproof.campaign.worker import FIGURES, columns, delta_column
from gustproof.simulate.flight import warnings

QUANTILES = {"median": 0.5, "p95": 0.95, "p99": 0.99}
"""Quantiles that are told of each figure, by name."""
COMPARED = ("rmse_deg", "peak_deg", "torque_rms_nm", "torque_slew_rms")
"""Figures in which laws are compared case by case."""
IMPORTANCE = (
    "rank_correlation: Spearman's; first_order: Sobol' index by binning, up to 'noise' not told from no effect at all"
)
"""How importance is measured."""
_WORST = 5

Places = NDArray[np.intp]


class Worst(NamedTuple):
    """A run that stands out."""

    run: int
    """Its number."""
    value: float
    """[unit of the figure] what it left."""


class Failure(NamedTuple):
    """A run that left no figures."""

    run: int
    """Its number."""
    reason: str
    """Why."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """One figure over the runs of a law, unit as in `Metrics`."""

    flown: int
    """Runs that have it."""
    mean: Estimate
    """Its mean."""
    quantiles: dict[str, Estimate]
    """Its quantiles by the names of `QUANTILES`."""
    worst: tuple[Worst, ...]
    """Runs with its largest values, the worst first."""
    importance: dict[str, Importance | None]
    """What each dispersion does to it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Passed:
    """What became of one requirement over the runs of a law."""

    requirement: Requirement
    """What had to hold."""
    rate: Estimate
    """[-] share of the runs that kept it."""
    worst: tuple[Worst, ...]
    """Runs that kept it least, the worst first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LawFindings:
    """What came of the runs of one law."""

    law: str
    """Name of the law."""
    figures: dict[str, Figure]
    """Figures by name."""
    passed: tuple[Passed, ...]
    """Requirements of the scenario."""
    all_held: Estimate
    """[-] share of the runs that kept all requirements, and left figures."""
    failures: tuple[Failure, ...]
    """Runs that left no figures; the first of them."""
    failed: int
    """How many they are."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Duel:
    """Two laws in the same cases."""

    figure: str
    """Name of the figure."""
    law: str
    """One law."""
    other: str
    """The other."""
    lower: Estimate
    """[-] share of the cases in which the figure of `law` is below that of `other`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Findings:
    """What came of a campaign."""

    table: Path
    """Its file."""
    campaign: Campaign
    """What was flown."""
    laws: tuple[LawFindings, ...]
    """What came of each law."""
    duels: tuple[Duel, ...]
    """Each pair of laws, in each of `COMPARED`."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What must be known of the laws on the nominal vehicle before their figures are believed, a line each."""
        flown = self.campaign
        return tuple(line for law in flown.laws for line in warnings(flown.scenario, law, flown.vehicles.nominal))

    def document(self) -> dict[str, Any]:
        """Return all of it as JSON has it; what is not finite is null."""
        campaign = self.campaign
        return {
            "table": str(self.table),
            "scenario": campaign.scenario.name,
            "vehicle": campaign.vehicles.document["name"],
            "runs": campaign.runs,
            "cases": campaign.cases,
            "seed": campaign.seed,
            "sampling": campaign.sampling.value,
            "spreads": _told(campaign.spreads),
            "warnings": list(self.warnings),
            "confidence": LEVEL,
            "importance": IMPORTANCE,
            "laws": {found.law: _told(found) for found in self.laws},
            "duels": _told(self.duels),
        }


def _told(value: Any) -> Any:
    """Return a finding as JSON has it."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Enum):
        return value.value
    if is_dataclass(value):
        return {field.name: _told(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return _told(value._asdict())
    if isinstance(value, Mapping):
        return {key: _told(item) for key, item in value.items()}
    return [_told(item) for item in value] if isinstance(value, tuple) else value


def findings(path: Path) -> Findings:
    """Return what came of the campaign in a file; columns are read one at a time, one law's dispersions are kept.

    Raises
    ------
    ConfigError
        If it is not a campaign's file.
    """
    campaign, table = read_campaign(path), opened(path)
    laws = tuple(_law(table, campaign, number) for number in range(len(campaign.laws)))
    compared = [name for name in FIGURES if name in COMPARED]
    duels = tuple(duel for name in compared for duel in _duels(name, read_column(table, name, campaign), campaign))
    return Findings(table=path, campaign=campaign, laws=laws, duels=duels)


def _figures(table: Any, campaign: Campaign, number: int) -> dict[str, Figure]:
    flown = np.flatnonzero(np.isfinite(read_column(table, FIGURES[0], campaign)[number]))
    deltas = {
        name: ranked(read_column(table, delta_column(name), campaign)[number][flown]) for name in campaign.spreads
    }
    first = number * campaign.cases
    return {name: _figure(read_column(table, name, campaign)[number], flown, first, deltas) for name in FIGURES}


def _figure(values: Array, flown: Places, first: int, deltas: dict[str, Ranked]) -> Figure:
    found = values[flown]
    if not len(found):
        nothing = Estimate(math.nan, -math.inf, math.inf)
        return Figure(flown=0, mean=nothing, quantiles=dict.fromkeys(QUANTILES, nothing), worst=(), importance={})
    order, ranks = ranked(found)
    return Figure(
        flown=len(found),
        mean=mean(found),
        quantiles={name: quantile(found[order], p) for name, p in QUANTILES.items()},
        worst=_largest(values, first, values),
        importance={name: importance(delta, found, ranks) for name, delta in deltas.items()},
    )


def _largest(values: Array, first: int, keys: Array) -> tuple[Worst, ...]:
    """Return the runs from `first` on with the largest keys; NaN is none."""
    falling = np.where(np.isnan(keys), math.inf, -keys)
    last = min(_WORST, len(falling)) - 1
    among = np.flatnonzero(falling <= np.partition(falling, last)[last])  # all to be sorted takes far longer
    order = among[np.argsort(falling[among], kind="stable")][:_WORST]
    return tuple(Worst(first + int(i), float(values[i])) for i in order if not math.isnan(keys[i]))


def _law(table: Any, campaign: Campaign, number: int) -> LawFindings:
    cases, first = campaign.cases, number * campaign.cases
    passed = []
    for requirement, name in zip(campaign.scenario.require, columns(campaign.scenario.require), strict=True):
        held = int(read_column(table, f"{name}_held", campaign)[number].sum())
        values = read_column(table, name, campaign)[number]
        worst = _largest(values, first, _excess(requirement, values))
        passed.append(Passed(requirement=requirement, rate=share(held, cases), worst=worst))
    reasons = table.read(columns=["failure"]).column(0).slice(first, cases)
    failed = np.flatnonzero(reasons.is_valid().to_numpy())
    return LawFindings(
        law=campaign.laws[number].name, figures=_figures(table, campaign, number), passed=tuple(passed),
        all_held=share(int(read_column(table, "held", campaign)[number].sum()), cases),
        failures=tuple(Failure(first + int(i), reasons[int(i)].as_py()) for i in failed[:_WORST]), failed=len(failed),
    )  # fmt: skip


def _excess(requirement: Requirement, values: Array) -> Array:
    """Return by how much values are beyond the nearer limit; negative within."""
    above = -math.inf if requirement.at_most is None else values - requirement.at_most
    below = -math.inf if requirement.at_least is None else requirement.at_least - values
    return np.maximum(above, below)


def _duels(figure: str, values: Array, campaign: Campaign) -> Iterator[Duel]:
    for one, other in combinations(range(len(campaign.laws)), 2):
        both = np.isfinite(values[one]) & np.isfinite(values[other])
        if both.any():
            lower = int(np.count_nonzero(values[one][both] < values[other][both]))
            names = (campaign.laws[one].name, campaign.laws[other].name)
            yield Duel(figure=figure, law=names[0], other=names[1], lower=share(lower, int(both.sum())))
