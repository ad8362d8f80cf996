"""Probability of a rare event in one flight, by subset simulation: levels of likelier events lead to it.

All that is random in a flight is a function of independent standard normal numbers: gusts, noise, the places of the
dispersions. Flights above a level are copied. Each copy is rotated slightly in the space of those numbers. The move is
rejected if its flight falls below the level (preconditioned Crank-Nicolson). So flights above the level multiply
without a change of their distribution. The probability is the product of the shares that pass from level to level.

One ensemble chooses levels and angles. Then independent ensembles pass these fixed levels: the estimate of each is free
of bias, and their spread gives the interval.

References
----------
S. K. Au, J. L. Beck, Estimation of small failure probabilities in high dimensions by subset simulation, Probabilistic
Engineering Mechanics 16, 2001.
I. Papaioannou and others, MCMC algorithms for subset simulation, Probabilistic Engineering Mechanics 41, 2015: the
turn in the normal space, and its angle from the share of accepted copies.
F. Cérou, P. Del Moral, T. Furon, A. Guyader, Sequential Monte Carlo for rare event estimation, Statistics and Computing
22, 2012: the estimate is free of bias on fixed levels.
"""

import json
import math
import re
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from firmware_model.config.scenario import NoiseRotation
from firmware_model.config.validation import none_of
from firmware_model.errors import ConfigError
from gustproof.errors import FlightError
from gustproof.flight.controllers.external_autopilot import ExternalAutopilot
from gustproof.flight.routes.batch import Case, CaseResult, make_batch_simulator
from gustproof.flight.routes.kernels import LANES
from gustproof.studies.campaign.executors import Pool
from gustproof.studies.campaign.intervals import CONFIDENCE, IntervalEstimate, positive_mean, proportion
from gustproof.studies.campaign.plan import Campaign, is_given, trust
from gustproof.studies.campaign.sampling import Sampling, draw_normals, flight_seeds, place_deltas
from gustproof.studies.campaign.worker import FIGURES, load_campaign
from gustproof.types import Array, finite_or_none

ENSEMBLES = 16
"""Independent ensembles that pass the levels; their spread gives the interval."""
LEAST = 1e-12
"""[-] smallest probability that is searched for."""
_KEPT = 0.25  # [-] of an ensemble above the next level
_SWEEPS = 3  # turns of each copy: fewer leave it too near to its sisters, more cost flights
_ACCEPTED = 0.44  # [-] share of accepted copies at which they differ most (Papaioannou and others, section 4.3)
_FIRST_ANGLE, _LARGEST_ANGLE = 0.7, 1.2  # [rad]
_GAIN = 1.5  # [-] on the logarithm of the angle, from the excess of accepted copies
_STREAM = 7  # of random numbers; a campaign uses 4 to 6
_HITS = 5


class Event(Protocol):
    """Event in a flight: a value of it above a limit."""

    @property
    def figure(self) -> str:
        """Name of the value."""

    @property
    def limit(self) -> float:
        """[unit of the figure]."""

    @property
    def text(self) -> str:
        """The event in words."""

    def value(self, result: CaseResult) -> float:
        """Return the value of a flight [unit of the figure]; NaN if it diverged."""


class Threshold(NamedTuple):
    """Event in a flight: a figure above a limit."""

    figure: str
    """Name of the figure in `Metrics`."""
    limit: float
    """[unit of the figure]."""

    @property
    def text(self) -> str:
        """The event as it is written on the command line."""
        return f"{self.figure} > {self.limit:g}"

    def value(self, result: CaseResult) -> float:
        """Return the figure of a flight."""
        return float(getattr(result.metrics, self.figure))


class Level(NamedTuple):
    """Level on the way to the event."""

    floor: float
    """[unit of the figure] that a flight must be above."""
    angle: float
    """[rad] of the turns of flights above it."""


class RareFlight(NamedTuple):
    """A flight in which the event happens, complete enough to repeat it."""

    value: float
    """[unit of the figure]; infinite if the flight diverges."""
    seed: int
    """Seed of gusts and noise."""
    turns: tuple[NoiseRotation, ...]
    """Turns of gusts and noise."""
    deltas: tuple[float, ...]
    """[-] normalised delta of each dispersion."""


class EnsembleResult(NamedTuple):
    """Result of one ensemble."""

    probability: float
    """[-] estimate."""
    flights: int
    """Number of flights."""
    hits: tuple[RareFlight, ...]
    """Worst flights of the event."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RareEstimate:
    """Probability of a rare event in one flight of a law."""

    law: str
    """Name of the law."""
    event: Event
    """Event."""
    probability: IntervalEstimate
    """[-] with its interval."""
    flights: int
    """Number of flights, those that chose the levels included."""
    levels: tuple[float, ...]
    """[unit of the figure] on the way to the event."""
    hits: tuple[RareFlight, ...]
    """Worst flights of the event, the worst first."""

    @property
    def plain_flights(self) -> float:
        """Number of plain flights whose count of events has a relative interval as wide; NaN if it is unknown."""
        p, low, high = self.probability
        if not 0.0 < low < high < math.inf:
            return math.nan
        error = math.log(high / low) / 2.0
        return (1.0 - p) / p * (1.96 / error) ** 2

    def to_dict(self) -> dict[str, Any]:
        """Return the estimate as JSON values; numbers that are not finite become null."""
        p, low, high = self.probability
        return {
            "law": self.law,
            "figure": self.event.figure,
            "limit": self.event.limit,
            "probability": p,
            "interval": [low, high],
            "confidence": CONFIDENCE,
            "flights": self.flights,
            "plain_flights": finite_or_none(self.plain_flights),
            "levels": list(self.levels),
            "hits": [
                {
                    "value": finite_or_none(hit.value),
                    "seed": hit.seed,
                    "turns": [{"seed": turn.seed, "angle_rad": turn.angle_rad} for turn in hit.turns],
                    "deltas": list(hit.deltas),
                }
                for hit in self.hits
            ],
        }


def parse_threshold(text: str) -> Threshold:
    """Return the event written as `FIGURE > LIMIT`.

    Raises
    ------
    ConfigError
        If it is written otherwise, or no figure of a flight has this name.
    """
    found = re.fullmatch(r"\s*(\w+)\s*>\s*(\S+)\s*", text)
    try:
        figure, limit = (found.group(1), float(found.group(2))) if found else ("", math.nan)
    except ValueError:
        figure, limit = "", math.nan
    if not math.isfinite(limit):
        raise ConfigError(f"the event is '{text}', must be a figure and its limit, such as 'peak_deg > 1'")
    if figure not in FIGURES:
        raise ConfigError(f"the event: {none_of(figure, FIGURES)}")
    return Threshold(figure, limit)


def estimate_rare(
    campaign: Campaign,
    event: Event,
    pool: Pool,
    *,
    confidence: float = CONFIDENCE,
    least: float = LEAST,
    progress: Callable[[float], None] | None = None,
) -> RareEstimate:
    """Return the probability of `event` in one flight of the campaign's law, with dispersions drawn as in a campaign.

    The campaign's number of cases is that of first flights, shared by `ENSEMBLES` ensembles of whole batches. A flight
    that diverges counts as one above any limit; one with dispersions that no vehicle can have, as one below. The same
    campaign gives the same estimate to the bit, on any pool. `confidence` [-] is that of the interval. An event less
    likely than `least` [-] counts as never. `progress` receives the share done, 0..1.

    Raises
    ------
    ConfigError
        If the campaign has several laws, does not fly in lanes, or its cases are not drawn independently.
    FlightError
        If a worker dies.
    """
    _check_campaign(campaign)
    shown, metadata = progress or (lambda _: None), json.dumps(campaign.metadata())
    try:
        levels, reached, flights = pool.submit(choose_levels, metadata, event, least).result()
        shown(1.0 / (1 + ENSEMBLES))
        results = [] if reached else _pass_all(metadata, event, levels, pool, shown)
    except pool.death_errors:
        raise FlightError("a worker died: out of memory, or installed differently") from None
    if results:
        found = positive_mean(np.array([result.probability for result in results]), confidence)
    else:  # the search for levels ended below the limit: no flight was above the last of them
        found = IntervalEstimate(0.0, 0.0, reached)
    return RareEstimate(
        law=campaign.laws[0].name,
        event=event,
        probability=found,
        flights=flights + sum(result.flights for result in results),
        levels=tuple(level.floor for level in levels),
        hits=tuple(sorted((hit for result in results for hit in result.hits), key=lambda hit: -hit.value)[:_HITS]),
    )


def _check_campaign(campaign: Campaign) -> None:
    """Raise `ConfigError` if rare events of a campaign can't be estimated."""
    if len(campaign.laws) != 1:
        raise ConfigError(f"a rare event is of one law, not {len(campaign.laws)}")
    if not (is_given(campaign.laws[0]) and campaign.flies_in_lanes):
        raise ConfigError("a rare event needs laws and a script without link, mode or controller events")
    if campaign.sampling not in (Sampling.UNIFORM, Sampling.NORMAL):
        drawn = campaign.sampling.value
        raise ConfigError(f"a rare event draws each flight for itself: --sampling uniform or normal, not {drawn}")


def _pass_all(
    metadata: str, event: Event, levels: Sequence[Level], pool: Pool, shown: Callable[[float], None]
) -> list[EnsembleResult]:
    """Pass the levels with each ensemble on the pool; return the results in the order of the ensembles."""
    waiting, running, done = list(range(ENSEMBLES)), dict[Future[EnsembleResult], int](), dict[int, EnsembleResult]()
    while waiting or running:
        while waiting and len(running) < pool.max_pending:
            number = waiting.pop(0)
            running[pool.submit(pass_levels, metadata, event, levels, number)] = number
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            done[running.pop(future)] = future.result()
            shown((1 + len(done)) / (1 + ENSEMBLES))
    return [done[number] for number in range(ENSEMBLES)]


def choose_levels(metadata: str, event: Event, least: float) -> tuple[list[Level], float, int]:
    """Return levels up to `event`, each passed by a quarter of those above the one before, and the flights flown.

    The second number is 0 if the levels lead to the event. Else no level leads on, or the event is less likely than
    `least`; the number is a rough upper bound of its probability.
    """
    ensemble = _Ensemble(load_campaign(metadata), event, ENSEMBLES)
    levels: list[Level] = []
    share, angle, n = 1.0, _FIRST_ANGLE, len(ensemble.values)
    while (floor := _next_level(ensemble.values)) < event.limit:
        if floor == -math.inf or share < least:
            return levels, share * proportion(0, n).high, ensemble.flights
        levels.append(Level(floor, angle))
        share *= float(np.mean(ensemble.values > floor))
        accepted = ensemble.advance(levels[-1])
        angle = min(angle * math.exp(_GAIN * (accepted - _ACCEPTED)), _LARGEST_ANGLE)
    return levels, 0.0, ensemble.flights


def _next_level(values: Array) -> float:
    """Return the level with a quarter of the values above it, or fewer if values are equal; -inf if there is none."""
    ordered = np.sort(values)
    level = float(ordered[round((1.0 - _KEPT) * len(ordered)) - 1])
    if level < ordered[-1]:
        return level
    below = ordered[ordered < ordered[-1]]
    return float(below[-1]) if len(below) else -math.inf


def pass_levels(metadata: str, event: Event, levels: Sequence[Level], number: int) -> EnsembleResult:
    """Return the result of the ensemble of a number on some levels."""
    ensemble = _Ensemble(load_campaign(metadata), event, number)
    probability = 1.0
    for level in levels:
        probability *= float(np.mean(ensemble.values > level.floor))
        if probability == 0.0:
            return EnsembleResult(0.0, ensemble.flights, ())
        ensemble.advance(level)
    probability *= float(np.mean(ensemble.values > event.limit))
    return EnsembleResult(probability, ensemble.flights, ensemble.hits())


class _Draw(NamedTuple):
    """All that is random in a flight."""

    seed: int
    """Seed of gusts and noise."""
    turns: tuple[NoiseRotation, ...]
    """Turns of gusts and noise."""
    normals: Array
    """(dispersions,) standard normal numbers."""


class _Ensemble:
    """Flights of one ensemble, its random numbers, and the count of its flights."""

    def __init__(self, campaign: Campaign, event: Event, number: int) -> None:
        law = trust(campaign.laws[0])
        if isinstance(law, ExternalAutopilot):
            raise TypeError(law)
        size = LANES * max(math.ceil(campaign.cases / (ENSEMBLES * LANES)), 2)
        self._campaign, self._event, self._simulate = campaign, event, make_batch_simulator(campaign.scenario, law)
        self._rng = np.random.default_rng(np.random.SeedSequence([campaign.seed, _STREAM, number]))
        self._next_seed = (number * 2**32) // (ENSEMBLES + 1)  # each ensemble has a part of all seeds
        self.flights = 0
        normals = draw_normals(campaign.seed, len(campaign.spreads), number * size, size)
        self._draws = [_Draw(seed, (), row) for seed, row in zip(self._take_seeds(size), normals, strict=True)]
        self.values = self._fly(self._draws)

    def _take_seeds(self, count: int) -> list[int]:
        self._next_seed += count
        return flight_seeds(self._campaign.seed, self._next_seed - count, count)

    def advance(self, level: Level) -> float:
        """Replace the flights not above a level by turned copies of those above; return the share of accepted turns.

        A turn after which the flight is not above the level is undone.
        """
        above = self.values > level.floor
        lost, parents = np.flatnonzero(~above), np.flatnonzero(above)
        if not len(lost):
            return _ACCEPTED
        chosen: NDArray[np.intp] = self._rng.choice(parents, len(lost))
        for at, parent in zip(lost, chosen, strict=True):
            self._draws[at], self.values[at] = self._draws[parent], self.values[parent]
        accepted = 0
        for _ in range(_SWEEPS):
            turned = self._rotate([self._draws[at] for at in lost], level.angle)
            for at, draw, value in zip(lost, turned, self._fly(turned), strict=True):
                if value > level.floor:
                    self._draws[at], self.values[at] = draw, value
                    accepted += 1
        return accepted / (_SWEEPS * len(lost))

    def _rotate(self, draws: Sequence[_Draw], angle: float) -> list[_Draw]:
        others = self._rng.standard_normal((len(draws), len(self._campaign.spreads)))
        return [
            _Draw(
                draw.seed,
                (*draw.turns, NoiseRotation(seed=seed, angle_rad=angle)),
                math.cos(angle) * draw.normals + math.sin(angle) * other,
            )
            for draw, seed, other in zip(draws, self._take_seeds(len(draws)), others, strict=True)
        ]

    def _fly(self, draws: Sequence[_Draw]) -> Array:
        """Return the figure of each flight; -inf without a flight, inf if it diverged."""
        self.flights += len(draws)
        values, cases = np.full(len(draws), -math.inf), dict[int, Case]()
        for i, draw in enumerate(draws):
            try:
                cases[i] = make_rare_case(self._campaign, draw.seed, draw.turns, self._deltas(draw))
            except ConfigError:  # no such vehicle can exist
                continue
        with np.errstate(all="ignore"):  # a flight that diverges is a result
            results = self._simulate(list(cases.values()))
        values[list(cases)] = [self._event.value(result) for result in results]
        return np.where(np.isnan(values), math.inf, values)

    def _deltas(self, draw: _Draw) -> tuple[float, ...]:
        return tuple(place_deltas(self._campaign.sampling, draw.normals).tolist())

    def hits(self) -> tuple[RareFlight, ...]:
        """Return the worst distinct flights above the limit."""
        best: dict[tuple[int, tuple[NoiseRotation, ...]], RareFlight] = {}
        for i in np.argsort(-self.values, kind="stable").tolist():
            draw, value = self._draws[i], float(self.values[i])
            if value > self._event.limit and len(best) < _HITS:
                best[draw.seed, draw.turns] = RareFlight(value, draw.seed, draw.turns, self._deltas(draw))
        return tuple(best.values())


def make_rare_case(campaign: Campaign, seed: int, turns: tuple[NoiseRotation, ...], deltas: Sequence[float]) -> Case:
    """Return the case of a flight with turned noise.

    Raises
    ------
    ConfigError
        If no such vehicle can exist, or no flight can start in this attitude.
    """
    return replace(campaign.make_case(deltas, seed), turns=turns)
