"""Fly a league: entries x scenarios x vehicles. Each cell is a campaign, in which all entries fly the same seeds.

A folder keeps laws tuned for a vehicle, operating points, and the table of each cell. So a league that was interrupted
resumes, and one with more entries or flights flies only those.
"""

import hashlib
import json
import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, as_completed
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic_core import to_jsonable_python

from firmware_model.config.files import parse_json, read_text, write_text
from firmware_model.config.scenario import Scenario
from firmware_model.config.uncertainty import VehicleSet
from firmware_model.config.validation import sanitize_line
from firmware_model.config.vehicle import Vehicle
from firmware_model.errors import ConfigError
from gustproof.design.tune import default_slew
from gustproof.errors import DesignError
from gustproof.flight.controllers.user_controller import Controller
from gustproof.law.form import parse_law
from gustproof.studies.campaign.executors import Pool
from gustproof.studies.campaign.growth import resume_campaign
from gustproof.studies.campaign.plan import Campaign
from gustproof.studies.campaign.reader import open_table, read_column
from gustproof.studies.campaign.runner import fly_campaign
from gustproof.studies.campaign.worker import requirement_columns
from gustproof.studies.league.course import WORST_DEG, fit_scenario
from gustproof.studies.league.entries import (
    REFERENCE,
    LeagueEntry,
    is_tuned,
    make_controller,
    parse_league_entry,
    tuning_air,
)
from gustproof.studies.league.ranking import OperatingPoint, Standings, classify, compute_standings, log_ratios
from gustproof.studies.operating_point import measure_operating_point
from gustproof.types import Array
from gustproof.version import software_versions

FORMAT = "gustproof-league-2"
_SLEW_S = 20.0
"""[s] flights in turbulence that measure the torque slew."""
_Progress = Callable[[float, str], None]
_Result = dict[str, Any]
_Team = Mapping[str, Controller]  # by vehicle


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LeaguePlan:
    """Everything that decides a league's result."""

    entries: tuple[LeagueEntry, ...]
    """Entrants with distinct names."""
    vehicles: tuple[VehicleSet, ...]
    """Vehicles with distinct names."""
    scenarios: tuple[Scenario, ...]
    """Course, in strengths for `paper`."""
    runs: int
    """Flights of each entry in each cell."""
    seed: int = 1
    """Seed of all flights."""

    def __post_init__(self) -> None:
        """Check that names are distinct."""
        for what, names in (
            ("entry", [each.name for each in self.entries]),
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
    """Vehicle, and the spreads that laws are tuned for."""

    def __str__(self) -> str:
        """Return its name."""
        return f"{self.scenario.name}, {self.vehicles.nominal.name}"


@dataclass(frozen=True, kw_only=True, eq=False)
class League:
    """A league that was flown, of n entries in m cells."""

    plan: LeaguePlan
    """Plan."""
    cells: tuple[Cell, ...]
    """(m,) cells that are scored."""
    skipped: tuple[Cell, ...]
    """Cells that are not: with the failed rotor the vehicle can't hover, whatever the law."""
    points: tuple[tuple[OperatingPoint, ...], ...]
    """(n, vehicles) measured operating points."""
    errors_deg: Array
    """(n, m, runs) [deg] error of each flight; NaN if it failed."""
    reference_deg: Array
    """(m, runs) [deg] of the reference entry."""
    failures: tuple[tuple[tuple[str, ...], ...], ...]
    """(n, m) reasons of the flights that count as the worst."""

    @cached_property
    def standings(self) -> Standings:
        """Scores and ranks."""
        return compute_standings(log_ratios(self.errors_deg, self.reference_deg))

    @cached_property
    def classes(self) -> tuple[str, ...]:
        """(n,) class of each entry's operating points."""
        return tuple(map(classify, self.points))

    @cached_property
    def ranks(self) -> tuple[tuple[int, int], ...]:
        """(n,) rank over all of each entry, and within its class."""
        over_all = self.standings.ranks(range(len(self.classes)))
        within: dict[int, int] = {}
        for name in set(self.classes):
            members = [i for i, found in enumerate(self.classes) if found == name]
            within |= dict(zip(members, self.standings.ranks(members), strict=True))
        return tuple((rank, within[i]) for i, rank in enumerate(over_all))

    @property
    def order(self) -> list[int]:
        """Numbers of the entries from the least error on."""
        return sorted(range(len(self.plan.entries)), key=lambda i: (self.standings.ratios[i].value, i))

    def to_dict(self) -> dict[str, Any]:
        """Return the league as JSON values, the entries in the order of their scores."""
        plan, found = self.plan, self.standings
        names = [each.name for each in plan.entries]
        document: dict[str, Any] = to_jsonable_python(
            {
                "format": FORMAT,
                "seed": plan.seed,
                "runs": plan.runs,
                "reference": REFERENCE,
                "vehicles": [each.nominal.name for each in plan.vehicles],
                "scenarios": {each.name: each.description for each in plan.scenarios},
                "not_scored": [_place(cell) for cell in self.skipped],
                "entrants": [self._entry_to_dict(i) for i in self.order],
                "pairs": [
                    {"entry": names[i], "other": names[j], **found.pairs[i][j]._asdict()}
                    for i, j in combinations(self.order, 2)
                ],
                "cells": [
                    {
                        **_place(cell),
                        "best": names[int(np.argmin(found.cells[:, k]))],
                        "reference_deg": self.reference_deg[k].tolist(),
                        "ratios": dict(zip(names, found.cells[:, k].tolist(), strict=True)),
                    }
                    for k, cell in enumerate(self.cells)
                ],
            },
            inf_nan_mode="null",
        )
        return document

    def _entry_to_dict(self, i: int) -> dict[str, Any]:
        reasons = [reason for cell in self.failures[i] for reason in cell]
        points = zip(self.plan.vehicles, self.points[i], strict=True)
        return {
            "name": self.plan.entries[i].name,
            "source": self.plan.entries[i].source,
            "rank": self.ranks[i][0],
            "class": self.classes[i],
            "class_rank": self.ranks[i][1],
            **self.standings.ratios[i]._asdict(),
            "failed": len(reasons),
            "first_failure": reasons[0] if reasons else None,
            "operating_points": {vehicles.nominal.name: point._asdict() for vehicles, point in points},
        }


def _place(cell: Cell) -> dict[str, str]:
    return {"scenario": cell.scenario.name, "vehicle": cell.vehicles.nominal.name}


def fly_league(plan: LeaguePlan, folder: Path, pool: Pool, *, progress: _Progress = lambda *_: None) -> League:
    """Return the league, after all of its work that `folder` does not hold.

    Raises
    ------
    ConfigError
        If a file is wrong, or the folder holds another league's flights.
    DesignError
        If no law can be tuned for an entry on a vehicle; the text names all of these.
    FlightError
        If the disk is full; finished work stays.
    """
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder}: {error.strerror}") from None
    return _Study(plan, folder, pool, progress).run()


class _Task(NamedTuple):
    """Work of one worker, whose result is kept in a file."""

    label: str
    """Name in progress and errors."""
    function: Callable[..., _Result]
    """Function that the worker calls."""
    arguments: tuple[Any, ...]
    """Its arguments."""
    depends_on: Sequence[Any]
    """Everything that the result depends on but for the versions, JSON values or records of them."""

    @property
    def file(self) -> str:
        """Name of the file of its result."""
        parts = [self.function.__name__, *self.depends_on, software_versions()]
        text = json.dumps(to_jsonable_python(parts, inf_nan_mode="constants"), sort_keys=True)
        return f"{hashlib.sha256(text.encode()).hexdigest()[:32]}.json"


def _tune(entry: LeagueEntry, vehicles: VehicleSet) -> _Result:
    """Return the law of an entry for a vehicle, or why there is none."""
    try:
        return make_controller(entry, vehicles).to_dict()
    except (DesignError, ConfigError) as error:
        return {"refused": sanitize_line(str(error))}


def _measure(controller: Controller, vehicle: Vehicle) -> _Result:
    """Return the operating point of a controller on a vehicle, or why it can't be measured."""
    try:
        with np.errstate(all="ignore"):  # a loop that diverges is a result
            return measure_operating_point(controller, vehicle, replace(tuning_air(), duration_s=_SLEW_S)).to_dict()
    except (DesignError, ConfigError, ValueError, np.linalg.LinAlgError) as error:
        return {"refused": sanitize_line(str(error))}


class _Study:
    """Stages of a league: tune laws, measure operating points, fly each cell."""

    def __init__(self, plan: LeaguePlan, folder: Path, pool: Pool, progress: _Progress) -> None:
        self._plan, self._folder, self._pool, self._progress = plan, folder, pool, progress

    def run(self) -> League:
        plan = self._plan
        cells, skipped = self._lay_out()
        entries = [*plan.entries]
        if all(each.source != REFERENCE for each in entries):
            entries.append(parse_league_entry(REFERENCE))
        teams = self._make_teams(entries)
        n, reference = len(plan.entries), [each.source for each in entries].index(REFERENCE)
        points = self._measure_points(teams[:n])
        flown = [self._fly(k / len(cells), cell, teams) for k, cell in enumerate(cells)]
        errors = np.array([each for each, _ in flown]).swapaxes(0, 1)
        return League(
            plan=plan,
            cells=cells,
            skipped=skipped,
            points=points,
            errors_deg=errors[:n],
            reference_deg=errors[reference],
            failures=tuple(tuple(reasons[i] for _, reasons in flown) for i in range(n)),
        )

    def _lay_out(self) -> tuple[tuple[Cell, ...], tuple[Cell, ...]]:
        """Return the cells that are scored, in strengths for their vehicles, and those that are not."""
        cells: list[Cell] = []
        skipped: list[Cell] = []
        for vehicles in self._plan.vehicles:
            fitted = [fit_scenario(each, vehicles.nominal) for each in self._plan.scenarios]
            if not any(fitted):
                raise ConfigError(f"'{vehicles.nominal.name}' can fly none of these scenarios to its end")
            for scenario, own in zip(self._plan.scenarios, fitted, strict=True):
                (skipped if own is None else cells).append(Cell(own or scenario, vehicles))
        return tuple(cells), tuple(skipped)

    def _make_teams(self, entries: Sequence[LeagueEntry]) -> list[_Team]:
        """Return each entry's controller by vehicle, under the entry's name."""
        tuned = {
            (each.source, vehicles.nominal.name): _Task(
                label=f"tuning {each.name} for {vehicles.nominal.name}",
                function=_tune,
                arguments=(each, vehicles),
                depends_on=(each.source, vehicles.document),
            )
            for each in entries
            for vehicles in self._plan.vehicles
            if is_tuned(each)
        }
        found = dict(zip(tuned, self._work([*tuned.values()]), strict=True))
        refused = [f"{tuned[key].label}: {each['refused']}" for key, each in found.items() if "refused" in each]
        if refused:
            raise DesignError("; ".join(refused))

        def controller(each: LeagueEntry, vehicles: VehicleSet) -> Controller:
            key = (each.source, vehicles.nominal.name)
            made = parse_law(found[key], tuned[key].label) if key in found else make_controller(each, vehicles)
            return replace(made, name=each.name)

        return [{v.nominal.name: controller(each, v) for v in self._plan.vehicles} for each in entries]

    def _measure_points(self, teams: Sequence[_Team]) -> tuple[tuple[OperatingPoint, ...], ...]:
        fleet, air = [each.nominal for each in self._plan.vehicles], tuning_air()
        tasks = [
            _Task(
                label=f"operating point of {team[vehicle.name].name} on {vehicle.name}",
                function=_measure,
                arguments=(team[vehicle.name], vehicle),
                depends_on=(team[vehicle.name].to_dict(), vehicle, air, _SLEW_S),
            )
            for team in teams
            for vehicle in fleet
        ]
        found = iter(self._work(tasks))
        return tuple(
            tuple(OperatingPoint.parse(next(found), default_slew(vehicle, air)) for vehicle in fleet) for _ in teams
        )

    def _work(self, tasks: Sequence[_Task]) -> list[_Result]:
        """Return the results of tasks, those that the folder lacks by the pool; one that kills its worker has none."""
        found = {task.file: parse_json(read_text(path)) for task in tasks if (path := self._path(task)).exists()}
        missing = {task.file: task for task in tasks if task.file not in found}
        running = {self._submit(task): task for task in missing.values()}
        alone = []  # ran when a worker died
        for number, future in enumerate(as_completed(running)):
            task = running[future]
            self._progress(number / len(running), task.label)
            if isinstance(future.exception(), self._pool.death_errors):
                alone.append(task)
            else:
                found[task.file] = self._keep(task, future.result())
        for task in alone:
            future = self._submit(task)
            died = isinstance(future.exception(), self._pool.death_errors)
            found[task.file] = {"refused": "its process died"} if died else self._keep(task, future.result())
        return [found[task.file] for task in tasks]

    def _submit(self, task: _Task) -> Future[_Result]:
        try:
            return self._pool.submit(task.function, *task.arguments)
        except self._pool.death_errors as error:  # the workers died between two tasks
            future: Future[_Result] = Future()
            future.set_exception(error)
            return future

    def _path(self, task: _Task) -> Path:
        return self._folder / task.file

    def _keep(self, task: _Task, result: _Result) -> _Result:
        write_text(self._path(task), json.dumps(result))
        return result

    def _fly(self, share: float, cell: Cell, teams: Sequence[_Team]) -> tuple[Array, list[tuple[str, ...]]]:
        """Return the errors of all entries (entries, runs) [deg] in a cell, NaN for failures, and their reasons."""
        place = _place(cell)
        laws = tuple(team[place["vehicle"]] for team in teams)
        seed = zlib.crc32(json.dumps([self._plan.seed, place]).encode())  # cells are independent
        asked = Campaign(
            scenario=cell.scenario, laws=laws, vehicles=cell.vehicles, spreads={}, cases=self._plan.runs, seed=seed
        )
        table = self._folder / f"{'-'.join(place.values())}.parquet"
        campaign, known_runs = resume_campaign(table, asked)
        self._progress(share, str(cell))
        if campaign.runs > known_runs:
            fly_campaign(campaign, table, self._pool, known=table if known_runs else None)
        places = [[law.name for law in campaign.laws].index(law.name) for law in laws]
        file, (column,) = open_table(table), requirement_columns(cell.scenario.require)
        errors = read_column(file, column, campaign)[places, : self._plan.runs]
        reasons = np.reshape(file.read(columns=["failure"]).column(0).to_pylist(), (len(campaign.laws), -1))[places]
        return np.where(errors < WORST_DEG, errors, np.nan), [
            tuple(_explain(*flight) for flight in zip(own, why, strict=False) if not flight[0] < WORST_DEG)
            for own, why in zip(errors.tolist(), reasons.tolist(), strict=True)
        ]


def _explain(error_deg: float, reason: str | None) -> str:
    """Return why a flight counts as the worst."""
    return reason or (f"tumbled: error {error_deg:.0f} deg" if math.isfinite(error_deg) else "diverged")
