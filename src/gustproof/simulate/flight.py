"""One flight from scenario to figures: flown over UDP, written as a bag, measured; recovered, and flown again."""

import platform
import shutil
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic_core import to_jsonable_python

from firmware_model.config.files import validate
from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.errors import ConfigError
from firmware_model.recording.durable_file import is_growing
from firmware_model.recording.journal import read_journal
from firmware_model.sim.fault_schedule import fault_schedule
from gustproof.controller.core import reference_excess
from gustproof.errors import FlightError
from gustproof.law.form import Law, parse_law
from gustproof.law.hover import is_stable_at_hover
from gustproof.recording.bag import UNFINISHED_PREFIX, read_bag, write_bag
from gustproof.scoring.metrics import Metrics, measure, peak_rate
from gustproof.scoring.requirements import RequirementResult, judge
from gustproof.simulate.outcome import FlightOutcome, describe, infer_outcome
from gustproof.simulate.processes import WORKING_PREFIX, fly
from gustproof.version import __version__


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedFlight:
    """What one flight left behind."""

    scenario: Scenario
    """Script that was flown."""
    law: Law | None
    """Law that flew it; `None` if it was a controller of another's."""
    vehicle: Vehicle
    """Vehicle that was flown."""
    seed: int
    """Seed of gusts and noise."""
    outcome: FlightOutcome
    """How it ended."""
    message: str
    """One line on how it ended, for people."""
    records: NDArray[np.void]
    """(n,) the journal's records."""
    bag: Path | None
    """Folder of the bag; `None` if not one sample was flown."""
    metrics: Metrics | None
    """Figures; `None` if fewer than two samples were flown."""
    pace: Mapping[str, Any] | None = None
    """How well the deadlines of real time were kept, as `sitl.Flight` has it."""

    @property
    def peak_rate(self) -> float:
        """[rad/s] largest magnitude of p, q, r."""
        return peak_rate(self.records)

    @property
    def has_expected_outcome(self) -> bool:
        """Whether the law flew it, or the autopilot where the script is about modes, the controller or the link."""
        expected = (
            {FlightOutcome.CONTROLLER_LOST, FlightOutcome.LEFT_OFFBOARD} if self.scenario.has_link_script else set()
        )
        return self.outcome in {FlightOutcome.DONE, *expected}

    @property
    def warnings(self) -> tuple[str, ...]:
        """What must be known before the figures are believed, a line each."""
        if self.law is None:
            return ()
        known = warnings(self.scenario, self.law, self.vehicle)
        missed = (self.pace or {}).get("missed_samples", 0)
        if not missed or self.scenario.has_link_script:  # the script's own losses need no warning
            return known
        off = "what the vehicle turned meanwhile is missing in its attitude"
        return (*known, f"{missed} samples never came to law '{self.law.name}': {off}")

    @property
    def requirements(self) -> tuple[RequirementResult, ...]:
        """What became of each requirement of the scenario."""
        return judge(self.records, self.scenario, self.vehicle)

    def named(self, scenario: str, law: str) -> bool:
        """Return whether this is a flight of `scenario` with `law`, whatever the seed."""
        return (self.scenario.name, _name(self.law)) == (scenario, law)

    def document(self) -> dict[str, Any]:
        """Return the flight as JSON has it; the figures stand at the top level under their names."""
        return {
            "scenario": self.scenario.name,
            "law": None if self.law is None else self.law.name,
            "vehicle": self.vehicle.name,
            "seed": self.seed,
            "outcome": self.outcome.name.lower(),
            "message": self.message,
            "bag": None if self.bag is None else str(self.bag),
            "warnings": list(self.warnings),
            **({} if self.metrics is None else asdict(self.metrics)),
            "pace": None if self.pace is None else dict(self.pace),
            "requirements": [result.document() for result in self.requirements],
        }


class FlightPlan(NamedTuple):
    """All that is needed to fly a flight, or to fly it again."""

    scenario: Scenario
    """Script."""
    law: Law
    """Law."""
    vehicle: Vehicle
    """Vehicle."""
    seed: int
    """Seed of gusts and noise."""
    real_time: bool
    """Whether at the pace of the clock; else in lockstep, where each repetition gives the same bits."""

    @property
    def name(self) -> str:
        """Name of the files that it leaves."""
        return f"{self.scenario.name}-{self.law.name}-seed{self.seed}"

    def note(self) -> dict[str, Any]:
        """Return the plan as JSON has it, from which `parse_plan` makes it again, and the versions that fly it."""
        return {
            "scenario": to_jsonable_python(self.scenario),
            "vehicle": to_jsonable_python(self.vehicle),
            "law": {**self.law.document(), "order": self.law.order},
            "seed": self.seed,
            "real_time": self.real_time,
            "versions": _versions(),
        }


def objections(scenario: Scenario, law: Law, vehicle: Vehicle) -> tuple[str, ...]:
    """Return why a flight should not begin, a line each: an unstable loop, and references that the law does not hold.

    The loop is the linear one at hover. For a law of rates it is the autopilot's own, of which nothing is said.
    """
    lines = []
    if law.dt == scenario.dt and is_stable_at_hover(law, vehicle, scenario) is False:
        lines.append(f"law '{law.name}' is unstable on vehicle '{vehicle.name}', by the linear model at hover")
    if excess := reference_excess(law, scenario.references):
        lines.append(excess)
    return tuple(lines)


def check(scenario: Scenario, law: Law, vehicle: Vehicle) -> None:
    """Refuse a flight that should not begin.

    Raises
    ------
    ConfigError
        If there are `objections`, the first of them; or if an event leaves a vehicle that can't be.
    """
    for _ in fault_schedule(vehicle, scenario):
        pass
    for line in objections(scenario, law, vehicle):
        raise ConfigError(f"{line}; --anyway flies it all the same")


def warnings(scenario: Scenario, law: Law, vehicle: Vehicle) -> tuple[str, ...]:
    """Return what must be known of a flight before its figures are believed, a line each."""
    lines = list(objections(scenario, law, vehicle))
    if law.provenance.vehicle not in ("", vehicle.name):
        lines.append(f"law '{law.name}' was designed for vehicle '{law.provenance.vehicle}', not '{vehicle.name}'")
    if scenario.references and not law.takes_references:
        ignored = f"it ignores the attitudes that '{scenario.name}' asks for"
        lines.append(f"law '{law.name}' has no reference input: {ignored}")
    return tuple(lines)


def parse_plan(note: Any, source: Path) -> FlightPlan:
    """Return the plan that a bag or a journal carries.

    Raises
    ------
    ConfigError
        If it carries none, or lacks the law.
    """
    scenario, law, vehicle, seed, real_time = _noted(note, source)
    if law is None:
        raise ConfigError(f"{source}: flown by a controller of its own, whose law is not in it")
    return FlightPlan(scenario, law, vehicle, seed, real_time)


def _noted(note: Any, source: Path) -> tuple[Scenario, Law | None, Vehicle, int, bool]:
    """Return what was flown, as `FlightPlan` has it; the law is `None` if a controller of its own has flown."""
    try:
        scenario, vehicle = note["scenario"], note["vehicle"]
        law = None if note["law"] is None else {key: value for key, value in note["law"].items() if key != "order"}
        seed, real_time = int(note["seed"]), bool(note["real_time"])
    except (AttributeError, KeyError, TypeError, ValueError):
        raise ConfigError(f"{source}: does not say what was flown") from None
    return (
        validate(Scenario, scenario, f"{source}: scenario"),
        None if law is None else parse_law(law, f"{source}: law"),
        validate(Vehicle, vehicle, f"{source}: vehicle"),
        seed,
        real_time,
    )


def fly_and_record(
    scenario: Scenario,
    law: Law,
    *,
    vehicle: Vehicle,
    seed: int,
    out: Path,
    real_time: bool = False,
    tlog: bool = False,
    progress: Callable[[float], None] | None = None,
    watched: Callable[[int, Path], None] | None = None,
) -> RecordedFlight:
    """Fly a scenario over UDP and leave its bag in the folder `out`, named for scenario, law and seed.

    `progress` and `watched` are those of `sitl.fly`. With `tlog` the MAVLink traffic is left beside the bag. The
    journal is removed once its bag is whole, or if there is nothing in it.

    Raises
    ------
    ConfigError
        If the bag exists already, or the flight can't be started as asked.
    FlightError
        If the bag can't be written; the journal stays, to `recover` from.
    """
    plan = FlightPlan(scenario, law, vehicle, seed, real_time)
    flown = fly(
        scenario, law, vehicle=vehicle, seed=seed, out=out, real_time=real_time, progress=progress,
        note=plan.note(), tlog=tlog, watched=watched,
    )  # fmt: skip
    return _write_flight(
        scenario, law, vehicle, seed, plan.note(), flown.records, flown.journal,
        outcome=flown.outcome, message=flown.message, realtime_factor=flown.realtime_factor,
        pace=flown.pace,
    )  # fmt: skip


def recover(folder: Path) -> list[RecordedFlight]:
    """Make the bags of flights that were cut off, from the journals in `folder`; return them.

    A flight to the end of its script gives the bag that it would have left itself.

    Raises
    ------
    ConfigError
        If there is no journal, one is no journal, lacks what was flown or still grows, or its bag exists with other
        records.
    FlightError
        If a bag can't be written; its journal stays.
    """
    journals = sorted(folder.glob("*.journal"))
    if not journals:
        raise ConfigError(f"{folder}: no journal here: nothing to recover")
    for journal in journals:
        if is_growing(journal):
            raise ConfigError(f"{journal}: the flight is not over")
    for leftover in (*folder.glob(f"{UNFINISHED_PREFIX}*"), *folder.glob(f"{WORKING_PREFIX}*")):
        shutil.rmtree(leftover, ignore_errors=True)  # a link to elsewhere stays
    return [_recover(journal) for journal in journals]


def _recover(journal: Path) -> RecordedFlight:
    header, records = read_journal(journal, sound=True)
    note = header.get("note", {})
    scenario, law, vehicle, seed, _ = _noted(note, journal)
    outcome = infer_outcome(records, scenario)
    ended = f"{describe(outcome, scenario, records)}, {len(records)} of {scenario.samples} samples"
    return _write_flight(
        scenario, law, vehicle, seed, note, records, journal, outcome=outcome, realtime_factor=0.0,
        message=f"{scenario.name}, {_name(law)}, seed {seed}: {ended}",
    )  # fmt: skip


def first_difference_s(records: NDArray[np.void], others: NDArray[np.void]) -> float | None:
    """Return the model time [s] of the first sample that two flights do not share to the bit, `None` if they all are.

    A flight that was cut off shares all samples with the whole one.
    """
    n = min(len(records), len(others))
    ours, theirs = (np.frombuffer(each[:n].tobytes(), dtype=np.uint64).reshape(n, -1) for each in (records, others))
    rows = np.flatnonzero(np.any(ours != theirs, axis=1))
    return float(records["time_us"][rows[0]] * 1e-6) if len(rows) else None


def _write_flight(
    scenario: Scenario, law: Law | None, vehicle: Vehicle, seed: int,
    note: Mapping[str, Any], records: NDArray[np.void], journal: Path, *,
    outcome: FlightOutcome, message: str, realtime_factor: float, pace: Mapping[str, Any] | None = None,
) -> RecordedFlight:  # fmt: skip
    """Write the bag of what was flown beside its journal, unless it is there already, and remove the journal."""
    bag = None
    if len(records):
        bag = journal.parent / f"{scenario.name}-{_name(law)}-seed{seed}"
        try:
            if not _is_bag_of(bag, records):
                paced = {} if pace is None else {"pace": dict(pace)}
                write_bag(bag, records, {**note, "outcome": outcome.name.lower(), **paced})
        except OSError as error:
            kept = f"what was flown is in {journal}: make room, then gustproof recover {bag.parent}"
            raise FlightError(f"{bag}: {error.strerror}; {kept}") from None
    journal.unlink(missing_ok=True)
    figures = len(records) >= 2
    return RecordedFlight(
        scenario=scenario, law=law, vehicle=vehicle, seed=seed,
        outcome=outcome, message=message, records=records, bag=bag,
        metrics=measure(records, vehicle, scenario, realtime_factor) if figures else None, pace=pace,
    )  # fmt: skip


def _is_bag_of(bag: Path, records: NDArray[np.void]) -> bool:
    """Return whether `bag` is there with these records: its writer was killed before it had removed the journal."""
    return bag.exists() and read_bag(bag)[1].tobytes() == records.tobytes()


def _name(law: Law | None) -> str:
    """Return the name of a law in texts and files."""
    return "own-controller" if law is None else law.name


def _versions() -> dict[str, str]:
    """Return what can change the bits of a flight; nothing that differs when it is flown again."""
    return {
        "gustproof": __version__,
        "python": platform.python_version(),
        "machine": platform.machine(),
        **{name: version(name) for name in ("numpy", "numba", "llvmlite", "pymavlink")},
    }
