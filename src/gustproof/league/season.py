"""Fly a league: all entrants in the same seeds of the same course, on a pool of workers, resumed from its ledger."""

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from firmware_model.config.scenario import Scenario
from firmware_model.config.uncertainty import VehicleSet
from firmware_model.errors import ConfigError
from gustproof.campaign.executors import Pool
from gustproof.campaign.intervals import IntervalEstimate
from gustproof.entries.entry import Pilot
from gustproof.errors import DesignError
from gustproof.law.form import parse_law
from gustproof.league.classes import Charge, PriceClass, classify, read_charge
from gustproof.league.course import BOX_SCENARIO, box_points, fit_scenario
from gustproof.league.entrants import REFERENCE, Entrant, is_tuned, make_pilot, parse_entrant, tuning_air
from gustproof.league.ledger import Ledger, Result
from gustproof.league.salt import commit, hidden_seeds
from gustproof.league.standings import Standings, compute_standings, log_ratios
from gustproof.league.tasks import Fly, Task, Tune, Weigh, run_task
from gustproof.synthesis.tune import default_slew
from gustproof.types import Array

FORMAT = "gustproof-league-1"
_PRICE_S = 20.0
"""[s] flights in turbulence that measure the torque slew."""
Progress = Callable[[float, str], None]


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
    def vehicle(self) -> str:
        """Name of the vehicle."""
        return self.vehicles.nominal.name


class BoxScore(NamedTuple):
    """An entrant off nominal, where it is worst."""

    ratio: float
    """[-] error over the reference's on the nominal vehicle, geometric mean of the flights."""
    vehicle: str
    """Name of the vehicle."""
    point: str
    """Name of the point of the box."""


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

    def losses(self, entrant: int) -> list[int]:
        """Return the cells in which another entrant has a lower error, the largest difference first."""
        cells, best = self.standings.cells, self.standings.cell_best
        lost = [k for k in range(len(self.cells)) if best[k] != entrant]
        return sorted(lost, key=lambda k: cells[best[k], k] / cells[entrant, k])

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
                for i in self.order
                for j in self.order
                if i < j
            ],
            "cells": [
                {
                    "scenario": cell.scenario.name,
                    "vehicle": cell.vehicle,
                    "best": names[found.cell_best[k]],
                    "reference_deg": [None if math.isnan(each) else each for each in self.reference_deg[k].tolist()],
                    "ratios": {name: float(found.cells[i, k]) for i, name in enumerate(names)},
                }
                for k, cell in enumerate(self.cells)
            ],
        }

    def _entrant_to_dict(self, i: int) -> dict[str, Any]:
        entrant, found, box = self.plan.entrants[i], self.standings, self.boxes[i]
        prices = zip(self.plan.vehicles, self.charges[i], strict=True)
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
            "prices": {vehicles.nominal.name: charge.to_dict() for vehicles, charge in prices},
        }


def _interval_to_dict(estimate: IntervalEstimate) -> dict[str, float | None]:
    return {name: value if math.isfinite(value) else None for name, value in estimate._asdict().items()}


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
        self._plan, self._ledger, self._pool, self._progress = plan, ledger, pool, progress

    def run(self) -> League:
        plan = self._plan
        fitted = [
            (scenario, vehicles, fit_scenario(scenario, vehicles.nominal))
            for vehicles in plan.vehicles
            for scenario in plan.scenarios
        ]
        cells = tuple(Cell(flown, vehicles) for _, vehicles, flown in fitted if flown is not None)
        skipped = tuple(Cell(scenario, vehicles) for scenario, vehicles, flown in fitted if flown is None)
        if not cells:
            raise ConfigError("no vehicle here can fly any of the scenarios to its end")
        reference = parse_entrant(REFERENCE)
        pilots = self._make_pilots([*plan.entrants, reference])
        air = replace(tuning_air(), duration_s=_PRICE_S)
        prices = [[Weigh(pilot=each, vehicle=v.nominal, scenario=air) for each, v in row] for row in pilots[:-1]]
        flights = [[self._fly(row, cell) for cell in cells] for row in pilots]
        boxes = [list(self._fly_box(row, cells)) for row in pilots[:-1]]
        self._do([*_flatten(flights), *(fly for row in boxes for _, fly, _ in row), *_flatten(prices)])
        errors = np.array([[self._errors(fly) for fly in row] for row in flights])
        return League(
            plan=plan,
            cells=cells,
            skipped=skipped,
            charges=tuple(
                tuple(read_charge(self._ledger[each.key], default_slew(each.vehicle, tuning_air())) for each in row)
                for row in prices
            ),
            errors_deg=errors[:-1],
            reference_deg=errors[-1],
            failures=tuple(tuple(self._ledger[fly.key] for fly in row) for row in flights[:-1]),
            boxes=tuple(self._score_box(row, errors[-1]) for row in boxes),
        )

    def _make_pilots(self, entrants: Sequence[Entrant]) -> list[list[tuple[Pilot, VehicleSet]]]:
        """Return each entrant's pilot and vehicle, on all vehicles; tuned laws come from the ledger."""
        tunings = {
            (each.source, vehicles.nominal.name): Tune(entrant=each, vehicles=vehicles)
            for each in entrants
            if is_tuned(each)
            for vehicles in self._plan.vehicles
        }
        self._do(tunings.values())
        refused = [
            f"{task.entrant.name} for {task.vehicles.nominal.name}: {found['refused']}"
            for task in tunings.values()
            if "refused" in (found := self._ledger[task.key])
        ]
        if refused:
            raise DesignError(f"not tuned: {'; '.join(refused)}")

        def pilot(entrant: Entrant, vehicles: VehicleSet) -> Pilot:
            task = tunings.get((entrant.source, vehicles.nominal.name))
            return make_pilot(entrant, vehicles) if task is None else parse_law(self._ledger[task.key]["law"], "")

        return [[(pilot(each, vehicles), vehicles) for vehicles in self._plan.vehicles] for each in entrants]

    def _fly(self, row: list[tuple[Pilot, VehicleSet]], cell: Cell) -> Fly:
        pilot, nominal = _pilot_on(row, cell.vehicle), cell.vehicles.nominal
        return Fly(pilot=pilot, vehicle=nominal, nominal=nominal, scenario=cell.scenario, seeds=self._seeds(cell))

    def _fly_box(self, row: list[tuple[Pilot, VehicleSet]], cells: Sequence[Cell]) -> Iterable[tuple[str, Fly, int]]:
        """Yield the name of each point of the box, its flights, and the number of the nominal cell."""
        for vehicles in self._plan.vehicles:
            own = [k for k, cell in enumerate(cells) if cell.vehicles is vehicles]
            number = next((k for k in own if cells[k].scenario.name == BOX_SCENARIO), own[0] if own else None)
            if number is None:
                continue
            cell = cells[number]
            for point in box_points(cell.scenario, vehicles):
                fly = Fly(
                    pilot=_pilot_on(row, cell.vehicle),
                    vehicle=point.vehicle,
                    nominal=vehicles.nominal,
                    scenario=point.scenario,
                    seeds=self._seeds(cell),
                )
                yield point.name, fly, number

    def _seeds(self, cell: Cell) -> Sequence[int]:
        return hidden_seeds(self._plan.salt, cell.scenario.name, cell.vehicle, self._plan.runs)

    def _errors(self, fly: Fly) -> list[float]:
        return [math.nan if each is None else each for each in self._ledger[fly.key]["errors_deg"]]

    def _score_box(self, points: Sequence[tuple[str, Fly, int]], reference: Array) -> BoxScore:
        scores = [
            BoxScore(
                float(np.exp(log_ratios(np.array(self._errors(fly)), reference[cell]).mean())), fly.nominal.name, name
            )
            for name, fly, cell in points
        ]
        return max(scores)

    def _do(self, tasks: Iterable[Task]) -> None:
        """Do the tasks that are not in the ledger; a task whose worker dies alone, twice, fails."""
        todo = {task.key: task for task in tasks}
        waiting = deque(key for key in todo if key not in self._ledger)
        running: dict[Future[Result], str] = {}
        suspects: deque[str] = deque()  # tasks that ran when a worker died: each flies alone
        of, finished = len(waiting), 0
        while waiting or suspects or running:
            while suspects or waiting:
                if len(running) >= (1 if suspects else self._pool.max_pending):
                    break
                key = suspects[0] if suspects else waiting.popleft()
                running[self._pool.submit(run_task, todo[key])] = key
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                key = running.pop(future)
                try:
                    result = future.result()
                except self._pool.death_errors:
                    if key not in suspects:
                        suspects.append(key)
                        continue
                    result = todo[key].fail("its process died")
                if key in suspects:
                    suspects.remove(key)
                self._ledger.add(key, result)
                finished += 1
                self._progress(finished / of, todo[key].label)


def _pilot_on(row: list[tuple[Pilot, VehicleSet]], vehicle: str) -> Pilot:
    return next(pilot for pilot, vehicles in row if vehicles.nominal.name == vehicle)


def _flatten(rows: Iterable[Iterable[Task]]) -> list[Task]:
    return [task for row in rows for task in row]
