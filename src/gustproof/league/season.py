"""Fly a league: all entrants in the same seeds of the same course, on a pool of workers, resumed from its ledger."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from firmware_model.config.scenario import Scenario
from firmware_model.config.uncertainty import VehicleSet
from firmware_model.config.vehicle import Vehicle
from firmware_model.errors import ConfigError
from gustproof.campaign.executors import Pool
from gustproof.campaign.intervals import IntervalEstimate
from gustproof.entries.entry import Pilot
from gustproof.errors import DesignError
from gustproof.law.form import parse_law
from gustproof.league.classes import Charge, PriceClass, classify, read_charge
from gustproof.league.course import BOX_SCENARIO, box_points, fit_scenario
from gustproof.league.dispatch import Dispatcher, Progress
from gustproof.league.entrants import REFERENCE, Entrant, is_tuned, make_pilot, parse_entrant, pilot_digest, tuning_air
from gustproof.league.ledger import Ledger, Result
from gustproof.league.salt import commit, hidden_seeds
from gustproof.league.standings import Standings, compute_standings, log_ratios
from gustproof.league.tasks import Fly, Task, Tune, Weigh
from gustproof.synthesis.tune import default_slew
from gustproof.types import Array

FORMAT = "gustproof-league-1"
_PRICE_S = 20.0
"""[s] flights in turbulence that measure the torque slew."""
_Team = Mapping[str, Pilot]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LeaguePlan:
    """Everything that decides a league's result."""

    entrants: tuple[Entrant, ...]
    """Entrants with distinct names."""
    vehicles: tuple[VehicleSet, ...]
    """Vehicles with distinct names."""
    scenarios: tuple[Scenario, ...]
    """Course, in strengths for `paper`."""
    runs: int
    """Flights of each entrant in each cell."""
    salt: str
    """Text that all seeds derive from."""

    def __post_init__(self) -> None:
        """Check that names are distinct."""
        for what, names in (
            ("entry", [each.name for each in self.entrants]),
            ("vehicle", [each.nominal.name for each in self.vehicles]),
            ("scenario", [each.name for each in self.scenarios]),
        ):
            if twice := [name for name in names if names.count(name) > 1]:
                raise ConfigError(f"--{what}: two of them have the name '{twice[0]}'")


class Cell(NamedTuple):
    """A scenario on a vehicle."""

    scenario: Scenario
    """Scenario, fitted to the vehicle."""
    vehicles: VehicleSet
    """Vehicle."""

    @property
    def nominal(self) -> Vehicle:
        """Vehicle with all numbers nominal."""
        return self.vehicles.nominal

    @property
    def vehicle(self) -> str:
        """Name of the vehicle."""
        return self.nominal.name


class BoxScore(NamedTuple):
    """An entrant off nominal, where it is worst."""

    ratio: float
    """[-] error over the reference's on the nominal vehicle, geometric mean of the flights."""
    vehicle: str
    """Name of the vehicle."""
    point: str
    """Name of the point of the box."""


class _BoxFlights(NamedTuple):
    """Flights off nominal."""

    name: str
    """Name of the point of the box."""
    cell: int
    """Number of the nominal cell."""
    flights: Fly
    """Flights."""


@dataclass(frozen=True, kw_only=True, eq=False)
class League:
    """A league that was flown."""

    plan: LeaguePlan
    """Plan."""
    cells: tuple[Cell, ...]
    """(m,) cells that are scored."""
    skipped: tuple[Cell, ...]
    """Cells that are not: with the failed rotor the vehicle can't hover, whatever the law."""
    charges: tuple[tuple[Charge, ...], ...]
    """(n, vehicles) prices."""
    digests: tuple[tuple[str, ...], ...]
    """(n, vehicles) SHA-256 of each pilot."""
    errors_deg: Array
    """(n, m, runs) [deg] error of each flight; NaN if it failed."""
    reference_deg: Array
    """(m, runs) [deg] of the reference entrant."""
    failures: tuple[tuple[Result, ...], ...]
    """(n, m) results of the flights."""
    boxes: tuple[BoxScore, ...]
    """(n,) robustness box."""

    @cached_property
    def standings(self) -> Standings:
        """Scores and ranks."""
        return compute_standings(log_ratios(self.errors_deg, self.reference_deg))

    @cached_property
    def classes(self) -> tuple[PriceClass, ...]:
        """(n,) price class of each entrant."""
        return tuple(classify(each) for each in self.charges)

    @cached_property
    def class_ranks(self) -> tuple[int, ...]:
        """(n,) rank of each entrant in its class."""
        ranks = [0] * len(self.plan.entrants)
        for each in set(self.classes):
            members = [i for i, found in enumerate(self.classes) if found == each]
            for i, rank in zip(members, self.standings.rank_within(members), strict=True):
                ranks[i] = rank
        return tuple(ranks)

    @property
    def order(self) -> list[int]:
        """Numbers of the entrants from the least error on."""
        return sorted(range(len(self.plan.entrants)), key=lambda i: (self.standings.ratios[i].value, i))

    def losses(self, entrant: int) -> list[tuple[int, int]]:
        """Return the cells that an entrant loses to another of its class, each with the best there.

        The largest loss comes first. Entrants of other classes pay another price.
        """
        cells, own = self.standings.cells, self.classes[entrant]
        rivals = [i for i, found in enumerate(self.classes) if found == own]
        best = [min(rivals, key=lambda i: float(cells[i, k])) for k in range(len(self.cells))]
        lost = [(k, i) for k, i in enumerate(best) if cells[i, k] < cells[entrant, k]]
        return sorted(lost, key=lambda pair: float(cells[pair[1], pair[0]] / cells[entrant, pair[0]]))

    def to_dict(self, *, reveal: bool = False) -> dict[str, Any]:
        """Return the league as JSON values, the entrants in the order of their scores; the salt if it is revealed."""
        plan, found = self.plan, self.standings
        names = [each.name for each in plan.entrants]
        return {
            "format": FORMAT,
            "salt_sha256": commit(plan.salt),
            **({"salt": plan.salt} if reveal else {}),
            "runs": plan.runs,
            "reference": REFERENCE,
            "vehicles": [each.nominal.name for each in plan.vehicles],
            "scenarios": {each.name: each.description for each in plan.scenarios},
            "not_scored": [{"scenario": each.scenario.name, "vehicle": each.vehicle} for each in self.skipped],
            "entrants": [self._entrant_to_dict(i) for i in self.order],
            "pairs": [
                {"entry": names[i], "other": names[j], **_interval_to_dict(found.pairs[i][j])}
                for i, j in combinations(self.order, 2)
            ],
            "cells": [self._cell_to_dict(k, names) for k in range(len(self.cells))],
        }

    def _cell_to_dict(self, k: int, names: Sequence[str]) -> dict[str, Any]:
        cell, found = self.cells[k], self.standings
        return {
            "scenario": cell.scenario.name,
            "vehicle": cell.vehicle,
            "best": names[found.cell_best[k]],
            "reference_deg": [_finite(each) for each in self.reference_deg[k].tolist()],
            "ratios": {name: float(found.cells[i, k]) for i, name in enumerate(names)},
        }

    def _entrant_to_dict(self, i: int) -> dict[str, Any]:
        entrant, found, box = self.plan.entrants[i], self.standings, self.boxes[i]
        prices = zip(self.plan.vehicles, self.charges[i], self.digests[i], strict=True)
        reasons = [reason for result in self.failures[i] for reason in result["failures"] if reason]
        return {
            "name": entrant.name,
            "source": entrant.source,
            "rank": found.ranks[i],
            "class": self.classes[i].name,
            "class_rank": self.class_ranks[i],
            **_interval_to_dict(found.ratios[i]),
            "box": box._asdict(),
            "failed": len(reasons),
            "first_failure": reasons[0] if reasons else None,
            "prices": {
                vehicles.nominal.name: {**charge.to_dict(), "pilot_sha256": digest}
                for vehicles, charge, digest in prices
            },
        }


def _interval_to_dict(estimate: IntervalEstimate) -> dict[str, float | None]:
    return {name: _finite(value) for name, value in estimate._asdict().items()}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def fly_league(plan: LeaguePlan, folder: Path, pool: Pool, *, progress: Progress = lambda *_: None) -> League:
    """Do the tasks of a league that are not in the ledger of `folder`, and return the league.

    Raises
    ------
    ConfigError
        If a file is wrong, or another process uses the folder.
    DesignError
        If no law can be tuned for an entrant on a vehicle.
    FlightError
        If the disk is full; finished results stay.
    """
    with Ledger(folder) as ledger:
        return _Season(plan, ledger, pool, progress).run()


class _Season:
    """Tasks of a league in their order: tune, then measure prices and fly."""

    def __init__(self, plan: LeaguePlan, ledger: Ledger, pool: Pool, progress: Progress) -> None:
        self._plan, self._ledger = plan, ledger
        self._dispatcher = Dispatcher(ledger, pool, progress)

    def run(self) -> League:
        """Return the league, after all tasks that it lacks."""
        plan, (cells, skipped) = self._plan, self._lay_out()
        teams = [*self._make_teams([*plan.entrants, parse_entrant(REFERENCE)])]
        air = replace(tuning_air(), duration_s=_PRICE_S)
        prices = [[self._weigh(team, vehicles, air) for vehicles in plan.vehicles] for team in teams[:-1]]
        flights = [[self._fly(team, cell, cell.scenario, cell.nominal) for cell in cells] for team in teams]
        boxes = [[*self._fly_box(team, cells)] for team in teams[:-1]]
        tasks: list[Task] = [*chain(*flights), *chain(*prices), *(point.flights for point in chain(*boxes))]
        self._dispatcher.do(tasks)
        errors = self._collect_errors(flights)
        return League(
            plan=plan,
            cells=cells,
            skipped=skipped,
            charges=tuple(tuple(map(self._charge, row)) for row in prices),
            digests=tuple(tuple(map(pilot_digest, team.values())) for team in teams[:-1]),
            errors_deg=errors[:-1],
            reference_deg=errors[-1],
            failures=tuple(self._results(row) for row in flights[:-1]),
            boxes=tuple(self._score_box(row, errors[-1]) for row in boxes),
        )

    def _lay_out(self) -> tuple[tuple[Cell, ...], tuple[Cell, ...]]:
        """Return the cells that are scored, in strengths for their vehicles, and those that are not."""
        cells: list[Cell] = []
        skipped: list[Cell] = []
        for vehicles in self._plan.vehicles:
            for scenario in self._plan.scenarios:
                fitted = fit_scenario(scenario, vehicles.nominal)
                (skipped if fitted is None else cells).append(Cell(fitted or scenario, vehicles))
        if lacking := {each.nominal.name for each in self._plan.vehicles} - {cell.nominal.name for cell in cells}:
            raise ConfigError(f"'{sorted(lacking)[0]}' can fly none of these scenarios to its end")
        return tuple(cells), tuple(skipped)

    def _make_teams(self, entrants: Sequence[Entrant]) -> Iterator[_Team]:
        """Yield each entrant's pilots, on all vehicles; tuned laws come from the ledger.

        Raises
        ------
        DesignError
            If a law can't be tuned; the text names all of these.
        """
        vehicles = {each.nominal.name: each for each in self._plan.vehicles}
        tunings = {
            (each.source, name): Tune(entrant=each, vehicles=vehicles[name])
            for each in entrants
            for name in vehicles
            if is_tuned(each)
        }
        self._dispatcher.do(tunings.values())
        found = {place: self._ledger[task.key] for place, task in tunings.items()}
        refused = [
            f"{tunings[place].label}: {result['refused']}" for place, result in found.items() if "law" not in result
        ]
        if refused:
            raise DesignError("; ".join(refused))
        laws = {place: parse_law(result["law"], tunings[place].label) for place, result in found.items()}
        for each in entrants:
            yield {name: laws.get((each.source, name)) or make_pilot(each, vehicles[name]) for name in vehicles}

    def _weigh(self, team: _Team, vehicles: VehicleSet, air: Scenario) -> Weigh:
        return Weigh(pilot=team[vehicles.nominal.name], vehicle=vehicles.nominal, scenario=air)

    def _charge(self, task: Weigh) -> Charge:
        return read_charge(self._ledger[task.key], default_slew(task.vehicle, tuning_air()))

    def _fly(self, team: _Team, cell: Cell, scenario: Scenario, vehicle: Vehicle) -> Fly:
        name = cell.nominal.name
        return Fly(
            pilot=team[name],
            vehicle=vehicle,
            nominal=cell.nominal,
            scenario=scenario,
            seeds=hidden_seeds(self._plan.salt, cell.scenario.name, name, self._plan.runs),
        )

    def _fly_box(self, team: _Team, cells: Sequence[Cell]) -> Iterator[_BoxFlights]:
        """Yield the flights off nominal of each vehicle, in the scenario of the box or else in its first."""
        for vehicles in self._plan.vehicles:
            own = [k for k, cell in enumerate(cells) if cell.vehicles is vehicles]
            number = next((k for k in own if cells[k].scenario.name == BOX_SCENARIO), own[0])
            cell = cells[number]
            for point in box_points(cell.scenario, vehicles):
                yield _BoxFlights(point.name, number, self._fly(team, cell, point.scenario, point.vehicle))

    def _score_box(self, points: Sequence[_BoxFlights], reference: Array) -> BoxScore:
        """Return the worst of the points of a box; `reference` (m, runs) has the reference's errors [deg]."""
        errors = self._collect_errors([[point.flights for point in points]])[0]
        scores = log_ratios(errors, reference[[point.cell for point in points]]).mean(axis=1)
        worst = int(np.argmax(scores))
        return BoxScore(math.exp(scores[worst]), points[worst].flights.nominal.name, points[worst].name)

    def _collect_errors(self, rows: Sequence[Sequence[Fly]]) -> Array:
        """Return the error of each flight (rows, columns, runs) [deg], NaN for failed ones."""
        return np.array([[result["errors_deg"] for result in self._results(row)] for row in rows], dtype=np.float64)

    def _results(self, row: Sequence[Fly]) -> tuple[Result, ...]:
        return tuple(self._ledger[flown.key] for flown in row)
