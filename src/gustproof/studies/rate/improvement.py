"""Better gains beside those judged: what they bring, and what they cost."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from gustproof.design.loops.models import AUTOPILOTS
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.scoring.metrics import Metrics, measure
from gustproof.robust.lti.margins import LoopMargins, worst_loop
from gustproof.studies.rate.advice import autopilot_kind
from gustproof.studies.rate.failure_case import is_held
from gustproof.studies.rate.judge import SAME, Judgement, Verdict
from gustproof.types import finite_or_none

_RANKS = tuple(Verdict)
"""Verdicts, the best first."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Improvement:
    """Better gains beside those judged."""

    now: Judgement
    """Judgement of the gains."""
    better: Judgement
    """Judgement of better ones."""
    where_now_fails: Metrics | None
    """Better gains flown where those judged fail; `None` without such a case, or if they run at another rate."""

    @property
    def slew_ratio(self) -> float | None:
        """Torque slew [-] over that of the judged gains; `None` if those have none."""
        return self.better.slew / self.now.slew if self.now.slew and self.better.slew is not None else None

    @property
    def is_for_autopilot(self) -> bool:
        """True if they are parameters of an autopilot, which a pilot can change in steps."""
        return autopilot_kind(self.better.law) is not None

    @property
    def brings(self) -> tuple[str, ...]:
        """Gains in words."""
        old, new = self.now.verdict, self.better.verdict
        verdict = () if new is old else (f"{new.value} in place of {old.value}",)
        return *verdict, *(f"less {what}" for what, ratio in self._ratios() if ratio < 1.0 - SAME)

    @property
    def costs(self) -> tuple[str, ...]:
        """Costs in words."""
        return tuple(f"{ratio:.3g} times the {what}" for what, ratio in self._ratios() if ratio > 1.0 + SAME)

    def describe(self) -> str:
        """Return in a line what gets better, and the cost."""
        brings = ", ".join(self.brings)
        return brings[:1].upper() + brings[1:] + (f", for {' and '.join(self.costs)}" if self.costs else "")

    def find_limits(self) -> dict[str, str]:
        """Return what is to be said, by name, of values at or beyond their limits in the autopilot's documents."""
        kind = autopilot_kind(self.better.law)
        if kind is None:
            return {}
        values = self.better.law.provenance.parameters
        texts = {name: AUTOPILOTS[kind].describe_limit(name, value) for name, value in values.items()}
        return {name: text for name, text in texts.items() if text}

    def to_dict(self) -> dict[str, Any]:
        """Return the judgement of the better gains as JSON values, and what they cost."""
        values, flown, failure = self.better.law.provenance.parameters, self.where_now_fails, self.now.failure
        return {
            **self.better.to_dict(),
            "title": self.describe(),
            "slew_ratio": self.slew_ratio,
            "at_limits": [f"{name} {values[name]:.4g}: {text}" for name, text in self.find_limits().items()],
            "where_now_fails": None
            if flown is None or failure is None
            else {
                "now_peak_deg": finite_or_none(failure.figures.peak_deg),
                "better_peak_deg": finite_or_none(flown.peak_deg),
            },
        }

    def _ratios(self) -> Iterator[tuple[str, float]]:
        """Yield name and new value over old one [-] of what has both."""
        for what, old, new in (
            ("error", self.now.rmse_deg, self.better.rmse_deg),
            ("torque slew", self.now.slew, self.better.slew),
            ("Ms over the spreads", self.now.Ms_over_spreads, self.better.Ms_over_spreads),
        ):
            if old and new is not None:
                yield what, new / old


def weigh(now: Judgement, better: Judgement, seed: int) -> Improvement | None:
    """Return better gains beside those judged, flown with `seed` where these fail; `None` if they are not better."""
    if _RANKS.index(better.verdict) > _RANKS.index(now.verdict):
        return None
    failure, flown = now.failure, None
    if failure is not None and math.isclose(failure.scenario.dt, better.law.dt):
        records = fly_direct(failure.scenario, better.law, vehicle=failure.vehicle, seed=seed)
        flown = measure(records, failure.vehicle, failure.scenario, law=better.law)
    weighed = Improvement(now=now, better=better, where_now_fails=flown)
    return weighed if weighed.brings else None


def least_margins(judged: Judgement) -> tuple[LoopMargins, LoopMargins] | None:
    """Return the worst margins of the axes, nominal and at the corners of the spreads; `None` without any."""
    if not judged.axes:
        return None
    return worst_loop([axis.nominal for axis in judged.axes]), worst_loop([axis.worst for axis in judged.axes])


def describe_end(figures: Metrics | None) -> str:
    """Return the peak [deg] of a flight, or that it lost the attitude."""
    if figures is None:
        return "-"
    return f"{figures.peak_deg:.3g}" if is_held(figures) else "attitude is lost"
