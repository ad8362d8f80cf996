"""One flight: plan, checks before it, record."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from pydantic_core import to_jsonable_python

from firmware_model.config.events import ControllerKill
from firmware_model.config.files import validate
from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import GRAVITY, Vehicle, check_body
from firmware_model.errors import ConfigError
from firmware_model.external.versions import doubt_version
from firmware_model.physics.rotors import can_hover
from firmware_model.recording.journal import record_blocks
from firmware_model.sim.fault_schedule import fault_schedule
from gustproof.airframe.hover import is_stable_at_hover, link_delay_samples
from gustproof.flight.controllers.external_autopilot import AnyController, parse_autopilot
from gustproof.flight.controllers.user_controller import (
    Controller,
    ControllerKind,
    UserController,
    find_program,
    parse_controller_metadata,
)
from gustproof.flight.recording.flown import FlownRecords, Tabled
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.flight.routes.upsets import describe_upsets
from gustproof.flight.scoring.estimator_view import EstimatorView, compare_estimates
from gustproof.flight.scoring.metrics import Metrics, measure
from gustproof.flight.scoring.requirements import RequirementResult, judge, requirement_label
from gustproof.law.form import Law, doubt_vehicle, parse_law
from gustproof.law.references import describe_untracked
from gustproof.types import Records
from gustproof.version import software_versions

if TYPE_CHECKING:
    import pyarrow

KillSchedule = tuple[int, float]
"""Samples flown when the controller is killed, and when a spare one takes over; infinite if none does."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Flight(Tabled):
    """Record of one flight; figures and requirements are computed at first use."""

    scenario: Scenario
    """Script."""
    controller: Controller | None
    """Law or user's controller in control; `None` for a real autopilot, or if it is not known."""
    vehicle: Vehicle
    """Vehicle."""
    seed: int
    """Seed of gusts and noise."""
    records: Records
    """(n,) journal records; fewer than the scenario has samples if the flight broke off.

    Those of a flight over UDP of more than 65,536 samples are read-only, and read from its journal while they are used.
    """
    outcome: FlightOutcome
    """End of the flight."""
    message: str
    """Outcome in one line, for people."""
    realtime_factor: float = 0.0
    """[-] simulated time over wall time from t = 0 to landing; 0 if unknown."""
    counters: Mapping[str, int] = field(default_factory=dict)
    """Irregularities on the vehicle's side, by cause."""
    timing: Mapping[str, Any] | None = None
    """Real-time deadlines: missed ones, set-points held, delays [us]; `None` in lockstep, or if unknown.

    Samples that the law stepped late or never got are included if its controller reported them.
    """
    link: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    """Effects of scripted link faults, by direction; empty if the script has none."""
    journal: Path | None = None
    """Journal file; `None` once a bag has replaced it."""
    autopilot: Mapping[str, Any] | None = None
    """Plan and facts of the real autopilot that flew: kind, version, build, parameters; `None` for our own."""
    estimates: Records | None = None
    """(n,) attitudes as a real autopilot told them, see `firmware_model.recording.estimates`; `None` for our own."""
    bag: Path | None = None
    """Folder of the bag; `None` if no sample was flown, or nothing was recorded."""
    nominal: Vehicle | None = None
    """Vehicle of which the flown one is a sample; `None` if it is none."""

    @property
    def law(self) -> Law | None:
        """Law in control; `None` for any other controller."""
        return self.controller if isinstance(self.controller, Law) else None

    @cached_property
    def metrics(self) -> Metrics | None:
        """Figures; `None` if fewer than two samples were flown."""
        if len(self.records) < 2:
            return None
        return measure(self.records, self.vehicle, self.scenario, self.realtime_factor, law=self.law)

    @cached_property
    def requirements(self) -> tuple[RequirementResult, ...]:
        """Result of each requirement of the scenario."""
        return judge(self.records, self.scenario, self.vehicle, law=self.law)

    @property
    def pilot_name(self) -> str:
        """Name of the law, the controller or the autopilot that flew, in texts and files."""
        if self.autopilot is not None:
            return str(self.autopilot["name"])
        return "own-controller" if self.controller is None else self.controller.name

    @cached_property
    def estimator_view(self) -> EstimatorView | None:
        """Errors of a real autopilot's own attitude; `None` for our own autopilot, or if too little was told."""
        return None if self.estimates is None else compare_estimates(self.records, self.estimates)

    @property
    def has_expected_outcome(self) -> bool:
        """True if the law flew to the end, or left OFFBOARD where the script is about modes, controller or link."""
        scripted = {FlightOutcome.CONTROLLER_LOST, FlightOutcome.LEFT_OFFBOARD}
        return self.outcome is FlightOutcome.DONE or (self.scenario.has_link_script and self.outcome in scripted)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Reasons to doubt the figures, a line each: known before the flight, and seen in it."""
        return (*self._known_warnings, *describe_upsets(self.records, self.scenario, self.vehicle))

    @property
    def _known_warnings(self) -> tuple[str, ...]:
        if self.autopilot is not None:
            flown = self.autopilot.get("flown", {})
            unknown, rounded = flown.get("unknown_parameters", ()), flown.get("rounded_parameters", {})
            doubt = doubt_version(str(self.autopilot.get("autopilot")), str(flown.get("version")))
            return (
                *filter(None, [doubt]),
                *(f"{flown['program']} has no parameter {name}, and ignored it" for name in unknown),
                *(
                    f"{flown['program']} keeps {name} as a whole number: {reported:g}, not {flown['parameters'][name]}"
                    for name, reported in rounded.items()
                ),
            )
        if self.law is None:
            return ()
        known = warnings(self.scenario, self.law, self.vehicle, self.nominal)
        missed = (self.timing or {}).get("missed_samples", 0)
        if not missed or self.scenario.has_link_script:  # losses that the script causes need no warning
            return known
        effect = "its attitude lacks the rotation in that time"
        return (*known, f"{missed} samples never came to law '{self.law.name}': {effect}")

    def lines(self) -> list[str]:
        """Return what flew, how it ended, its figures, and what of the scenario's requirements failed."""
        met = [result for result in self.requirements if result.is_met]
        failed = [requirement_label(each.requirement) for each in self.requirements if not each.is_met]
        told = f"{len(met)} of {len(self.requirements)} met"
        return [
            f"{self.scenario.name}: {self.pilot_name} on vehicle {self.vehicle.name}, seed {self.seed}",
            f"end: {self.message.rpartition(f'seed {self.seed}: ')[2]}",
            *([] if self.metrics is None else self.metrics.lines()[1:]),
            *([f"requirements: {'; failed: '.join([told, *failed])}"] if self.requirements else []),
            *(f"warning: {line}" for line in self.warnings),
        ]

    def report(self, path: Path | str, *others: "Flight") -> None:
        """Write the page of `gustproof report` on this flight and `others` to a new file.

        Raises
        ------
        ConfigError
            If there are more flights than a page shows, or the file exists.
        """
        show = "gustproof.show.report.html"  # pages stand above what flies
        runs = import_module(f"{show}.runs").as_runs((self, *others))
        import_module(f"{show}.page").write_report(runs, Path(path))

    def to_arrow(self) -> "pyarrow.Table":
        """Return the samples as a table, see `FlownRecords.to_arrow`."""
        return FlownRecords.of(self.records).to_arrow()

    def matches(self, scenario: str, law: str) -> bool:
        """Return whether this is a flight of `scenario` with `law`, whatever the seed."""
        return (self.scenario.name, self.pilot_name) == (scenario, law)

    def to_dict(self) -> dict[str, Any]:
        """Return the flight as JSON; the figures stand at the top level under their names."""
        return {
            "scenario": self.scenario.name,
            "law": None if self.law is None else self.law.name,
            **({} if self.autopilot is None else {"autopilot": dict(self.autopilot)}),
            **({"controller": self.controller.to_dict()} if isinstance(self.controller, UserController) else {}),
            "vehicle": self.vehicle.name,
            "seed": self.seed,
            "outcome": self.outcome.name.lower(),
            "message": self.message,
            "bag": None if self.bag is None else str(self.bag),
            "warnings": list(self.warnings),
            **({} if self.metrics is None else asdict(self.metrics)),
            **({} if self.estimator_view is None else {"own_view": asdict(self.estimator_view)}),
            "pace": None if self.timing is None else dict(self.timing),
            "requirements": [result.to_dict() for result in self.requirements],
        }


class FlightPlan(NamedTuple):
    """Everything needed to fly a flight, or to repeat it."""

    scenario: Scenario
    """Script."""
    controller: AnyController
    """Law, a controller of the user's, or a real autopilot."""
    vehicle: Vehicle
    """Vehicle."""
    seed: int
    """Seed of gusts and noise."""
    real_time: bool
    """True at the pace of the clock; otherwise lockstep, where each repetition gives the same bits."""
    nominal: Vehicle | None = None
    """Vehicle of which the flown one is a sample: what the maker of a controller knows; `None` for the flown one."""

    @property
    def name(self) -> str:
        """Name of the files of this flight."""
        return flight_name(self.scenario, self.controller.name, self.seed)

    def metadata(self) -> dict[str, Any]:
        """Return the plan as JSON for `parse_plan`, with the versions of the software that flies it."""
        return {
            "scenario": to_jsonable_python(self.scenario),
            "vehicle": to_jsonable_python(self.vehicle),
            **_describe_controller(self.controller),
            **({} if self.nominal is None else {"nominal": to_jsonable_python(self.nominal)}),
            "seed": self.seed,
            "real_time": self.real_time,
            "versions": software_versions(),
        }


def objection(scenario: Scenario, law: Law, vehicle: Vehicle) -> str:
    """Return the reason not to fly, a loop that is unstable by the linear model at hover; empty if there is none.

    The loop of a rates law is the autopilot's own and is not judged.
    """
    if law.dt != scenario.dt or is_stable_at_hover(law, vehicle, scenario) is not False:
        return ""
    constant, _ = link_delay_samples(scenario)
    late = f" with {1000.0 * constant * scenario.dt:g} ms of link delay" if constant else ""
    return f"law '{law.name}' is unstable on vehicle '{vehicle.name}'{late}, by the linear model at hover"


def _doubt_link(scenario: Scenario, law: Law, vehicle: Vehicle) -> str:
    """Return the reason to doubt a loop that passing delays or jitter of the link may make unstable; empty if none."""
    _, most = link_delay_samples(scenario)
    if law.dt != scenario.dt or is_stable_at_hover(law, vehicle, scenario, link_samples=most) is not False:
        return ""
    late = f"{1000.0 * most * scenario.dt:g} ms"
    return f"law '{law.name}' is unstable while the link is late by {late}, by the linear model at hover"


def check(scenario: Scenario, controller: Controller, vehicle: Vehicle) -> None:
    """Refuse a flight that should not begin.

    Raises
    ------
    ConfigError
        If there is an `objection` to a law, a program is not there, or the vehicle is impossible, at first or after an
        event.
    """
    if isinstance(controller, UserController) and controller.kind is ControllerKind.PROGRAM:
        find_program(controller.source)
    check_body(vehicle.inertia_B, vehicle.inertia_B, f"vehicle '{vehicle.name}'")
    for sample, plant in fault_schedule(vehicle, scenario):
        after = f"scenario '{scenario.name}': vehicle '{vehicle.name}' from {sample * scenario.dt:g} s on"
        check_body(plant.vehicle.inertia_B, plant.vehicle.inertia_B, after)
    if isinstance(controller, Law) and (line := describe_untracked(scenario, controller)):
        raise ConfigError(line)
    if isinstance(controller, Law) and (line := objection(scenario, controller, vehicle)):
        other = "" if controller.provenance.fits(vehicle) else f", and designed for '{controller.provenance.vehicle}'"
        raise ConfigError(f"{line}{other}; --anyway flies it all the same")


def warnings(scenario: Scenario, law: Law, vehicle: Vehicle, nominal: Vehicle | None = None) -> tuple[str, ...]:
    """Return reasons to doubt the figures of a flight of a vehicle, or of a sample of a `nominal` one, a line each."""
    lines = [line for line in (objection(scenario, law, vehicle) or _doubt_link(scenario, law, vehicle),) if line]
    lines += [line for line in (doubt_vehicle(law, nominal or vehicle),) if line]
    lines += [
        f"vehicle '{vehicle.name}' can't hover after the rotor failure at {sample * scenario.dt:g} s"
        for sample, plant in fault_schedule(vehicle, scenario)
        if min(plant.health) < 1.0 and not can_hover(vehicle.rotors, plant.health, plant.vehicle.mass * GRAVITY)
    ][:1]
    if scenario.references and not law.takes_references:
        lines.append(
            f"law '{law.name}' has no reference input: it ignores the attitude references of '{scenario.name}'"
        )
    return tuple(lines)


def parse_plan(metadata: Any, source: Path) -> FlightPlan:
    """Return the plan in the metadata of a bag or a journal.

    A law can fly at once, a user's controller only after `confirm_controller`, an autopilot after `confirm_autopilot`.

    Raises
    ------
    ConfigError
        If there is none, or the law is missing.
    """
    scenario, known, vehicle, seed, real_time = parse_metadata(metadata, source)
    autopilot = metadata.get("autopilot")
    controller = parse_autopilot(autopilot, source) if autopilot else known
    if controller is None:
        raise ConfigError(f"{source}: flown by a controller of its own, whose law is not in it")
    return FlightPlan(scenario, controller, vehicle, seed, real_time, parse_nominal(metadata, source))


def parse_nominal(metadata: Mapping[str, Any], source: Path) -> Vehicle | None:
    """Return the vehicle of which the flown one is a sample; raises `ConfigError` as `parse_plan` does."""
    nominal = metadata.get("nominal")
    return None if nominal is None else validate(Vehicle, nominal, f"{source}: nominal vehicle")


def _describe_controller(controller: AnyController) -> dict[str, Any]:
    if isinstance(controller, Law):
        return {"law": {**controller.to_dict(), "order": controller.order}}
    kind = "controller" if isinstance(controller, UserController) else "autopilot"
    return {"law": None, kind: controller.to_dict()}


def parse_metadata(metadata: Any, source: Path) -> tuple[Scenario, Controller | None, Vehicle, int, bool]:
    """Return the fields of a `FlightPlan`; the controller is `None` if nothing is known of it but its commands.

    Raises
    ------
    ConfigError
        If a field is missing or not allowed.
    """
    try:
        scenario, vehicle = metadata["scenario"], metadata["vehicle"]
        law = metadata["law"] and {key: value for key, value in metadata["law"].items() if key != "order"}
        entry = metadata.get("controller")
        seed, real_time = int(metadata["seed"]), bool(metadata["real_time"])
    except (AttributeError, KeyError, TypeError, ValueError):
        raise ConfigError(f"{source}: does not say what was flown") from None
    script = validate(Scenario, scenario, f"{source}: scenario")
    controller: Controller | None = None if entry is None else parse_controller_metadata(entry, source)
    if law is not None:
        controller = parse_law(law, f"{source}: law")
    return script, controller, validate(Vehicle, vehicle, f"{source}: vehicle"), seed, real_time


def first_difference_s(records: Records, others: Records) -> float | None:
    """Return the model time [s] of the first sample in which two flights differ; `None` if no bit differs.

    A flight that was cut off shares all of its samples with the whole one.
    """
    n, words = min(len(records), len(others)), records.dtype.itemsize // 8
    for pair in zip(record_blocks(records[:n]), record_blocks(others[:n]), strict=True):
        ours, theirs = (np.frombuffer(each.tobytes(), dtype=np.uint64).reshape(-1, words) for each in pair)
        if len(rows := np.flatnonzero(np.any(ours != theirs, axis=1))):
            return float(pair[0]["time_us"][rows[0]] * 1e-6)
    return None


def kill_schedule(scenario: Scenario) -> KillSchedule | None:
    """Return when the script kills the controller; `None` if it does not."""
    for item in scenario.event:
        if isinstance(item, ControllerKill):
            away_s = item.recovers_after_s
            restart = math.inf if away_s is None else scenario.nearest_sample(item.at_s + away_s)
            return scenario.nearest_sample(item.at_s), restart
    return None


def flight_name(scenario: Scenario, controller: str, seed: int) -> str:
    """Return the name of a flight's files; `controller` is the law or the autopilot."""
    return f"{scenario.name}-{controller}-seed{seed}"
