"""A flight of a real autopilot in our world, by a process of its own that starts and ends the autopilot.

    python -m firmware_model.external  <== its simulator's protocol, MAVLink ==>  the autopilot

The process leaves the journal, the autopilot's own attitude beside it, and the folder that the autopilot ran in.
"""

import json
import shlex
import subprocess
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from pydantic_core import to_jsonable_python

from firmware_model.config.firmware import check_rotors
from firmware_model.config.scenario import CONTROL_RATE_HZ, Scenario
from firmware_model.config.validation import none_of
from firmware_model.config.vehicle import Vehicle
from firmware_model.errors import ConfigError, naming
from firmware_model.external.interface import SAMPLE_RATES_HZ, WITHOUT_LOCKSTEP, ExternalOutcome, scenario_for
from firmware_model.recording.estimates import ATTITUDE_SUFFIX, read_estimates
from firmware_model.recording.journal import RECORD, count_records, read_journal
from gustproof.flight.controllers.user_controller import refuse_named
from gustproof.flight.routes.flight import Flight, flight_name, parse_metadata
from gustproof.flight.routes.outcome import FlightOutcome, blame_physics, describe
from gustproof.flight.routes.processes import WORKING_PREFIX, launch, terminate
from gustproof.version import software_versions

AUTOPILOTS = tuple(SAMPLE_RATES_HZ)
"""Autopilots that can be flown, by the names of `--autopilot`."""
_POLL_S = 0.02
_STILL_S = 300.0
"""[s] without a record, from the start on, by which the process counts as hung: arming may take 120 s of model time."""
_BAD_INPUT = 2  # exit status of the process


@dataclass(frozen=True, slots=True, kw_only=True)
class ExternalAutopilot:
    """A build of a real autopilot with its parameters and, if one is built into it, a law inside.

    Examples
    --------
    >>> from gustproof import ExternalAutopilot
    >>> ExternalAutopilot(kind="px4", parameters="tuned").name
    'px4-tuned'
    """

    kind: str
    """One of `AUTOPILOTS`."""
    build: str = ""
    """Folder of its build; empty for the usual places."""
    parameters: str = ""
    """Shipped set or file of parameters, on top of those that the vehicle file gives; empty for none."""
    law: str = ""
    """Law that was built into it and flies in place of its own loops; empty for its own."""
    instance: int | None = None
    """Number of its instance, which sets its ports; `None` for a free one."""
    given: bool = field(default=True, compare=False)
    """True if its user named it. One that a bag or a table names is never started, see `confirm_autopilot`."""

    def __post_init__(self) -> None:
        """Check the kind."""
        if self.kind not in AUTOPILOTS:
            raise ConfigError(f"--autopilot: {none_of(self.kind, AUTOPILOTS)}")

    @property
    def name(self) -> str:
        """Name in texts and files."""
        return "-".join(filter(None, (self.kind, Path(self.parameters).stem, self.law)))

    @property
    def has_lockstep(self) -> bool:
        """True if its clock is ours; otherwise it flies at the pace of the machine's, and no two flights are equal."""
        return self.kind not in WITHOUT_LOCKSTEP

    def check_given(self, where: object = "") -> None:
        """Refuse to start an autopilot that its user did not name; the text begins with `where`.

        Raises
        ------
        ConfigError
            If only a file names it. The text says what to type.
        """
        if not self.given:
            words = {"--autopilot": self.kind, "--build": self.build, "--params": self.parameters}
            line = shlex.join([word for option, value in words.items() if value for word in (option, value)])
            raise refuse_named(where, "an autopilot, which is a program", line)

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON values, input of `parse_autopilot`."""
        return {
            "autopilot": self.kind,
            "name": self.name,
            "build": self.build,
            "parameters": self.parameters,
            "law": self.law,
            "instance": self.instance,
        }


class ExternalPlan(NamedTuple):
    """Everything needed to fly a real autopilot, or to repeat its flight."""

    scenario: Scenario
    """Script."""
    autopilot: ExternalAutopilot
    """Autopilot in control."""
    vehicle: Vehicle
    """Vehicle."""
    seed: int
    """Seed of gusts and noise."""
    real_time: bool
    """True at the pace of the clock; otherwise as fast as the autopilot answers."""

    @property
    def name(self) -> str:
        """Name of the files of this flight."""
        return flight_name(self.scenario, self.autopilot.name, self.seed)

    def metadata(self) -> dict[str, Any]:
        """Return the plan as JSON, with the versions of the software that simulates it."""
        return {
            "scenario": to_jsonable_python(self.scenario),
            "vehicle": to_jsonable_python(self.vehicle),
            "law": None,
            "autopilot": self.autopilot.to_dict(),
            "seed": self.seed,
            "real_time": self.real_time,
            "versions": software_versions(),
        }


def parse_autopilot(document: Any, source: object) -> ExternalAutopilot:
    """Return the autopilot that `ExternalAutopilot.to_dict` has written.

    It tells what flew and can't be started: the document may come from anywhere, see `confirm_autopilot`.

    Raises
    ------
    ConfigError
        If a field is missing or wrong.
    """
    try:
        kind, instance = str(document["autopilot"]), document.get("instance")
        texts = {key: str(document[key]) for key in ("build", "parameters", "law")}
        number = None if instance is None else int(instance)
        return ExternalAutopilot(kind=kind, instance=number, given=False, **texts)
    except (AttributeError, KeyError, TypeError, ValueError):
        raise ConfigError(f"{source}: does not say which autopilot flew") from None


def confirm_autopilot(flown: ExternalAutopilot, given: ExternalAutopilot | None, where: object) -> ExternalAutopilot:
    """Return `flown` with the build and the parameters that a user gives to fly it again.

    Raises
    ------
    ConfigError
        If none is given, or it is another one; the text begins with `where`.
    """
    if given is None:
        flown.check_given(where)
        return flown
    if given.kind != flown.kind or Path(given.parameters).name != Path(flown.parameters).name:
        raise ConfigError(f"{where}: flown by '{flown.name}', not '{given.name}'")
    if flown.build and not given.build:
        raise ConfigError(f"{where}: flown by the build {flown.build}; give that, or a copy: --build FOLDER")
    return replace(flown, build=given.build, parameters=given.parameters, given=True)


def parse_external_plan(metadata: Any, source: Path) -> ExternalPlan:
    """Return the plan in the metadata of a bag.

    Raises
    ------
    ConfigError
        If there is none.
    """
    scenario, _, vehicle, seed, real_time = parse_metadata(metadata, source)
    return ExternalPlan(scenario, parse_autopilot(metadata.get("autopilot"), source), vehicle, seed, real_time)


def check_external(scenario: Scenario, kind: str) -> None:
    """Refuse a scenario that an autopilot of a kind can't fly as it stands.

    Raises
    ------
    ConfigError
        If it scripts our autopilot's link, its modes, its controller or its position loop, or starts free flight in
        another attitude. If it asks for another rate than the autopilot's: one that is neither that nor the default.
    """
    rate_hz = SAMPLE_RATES_HZ[kind]
    if scenario.control_rate_hz not in (rate_hz, CONTROL_RATE_HZ):
        asked = f"scenario '{scenario.name}' asks for {scenario.control_rate_hz} samples a second"
        raise ConfigError(f"{asked}, {kind} takes {rate_hz}: leave control_rate_hz out, or say {rate_hz}")
    if scenario.has_link_script:
        why = "scripts link, controller or modes of our own autopilot"
        raise ConfigError(f"scenario '{scenario.name}' {why}: no other autopilot can fly it")
    if scenario.holds_place:
        raise ConfigError(
            f"scenario '{scenario.name}' flies the position loop of our own autopilot: say 'free' or 'held'"
        )
    if scenario.free and any(scenario.initial_attitude_deg):
        raise ConfigError(f"scenario '{scenario.name}' begins free flight in a tilt that no autopilot holds")


def describe_rate(scenario: Scenario, kind: str) -> str:
    """Return in words that an autopilot flies a scenario of the default rate at its own; empty for any other."""
    rate_hz = SAMPLE_RATES_HZ[kind]
    if scenario.control_rate_hz == rate_hz or scenario.control_rate_hz != CONTROL_RATE_HZ:
        return ""
    return f"{kind} takes {rate_hz} samples a second: the gusts are those of the seed at that rate"


def find_build(kind: str, given: Path | None = None) -> Path:
    """Return the build of an autopilot that a flight will start, before a process is started for it.

    Raises
    ------
    ConfigError
        If there is none.
    """
    from firmware_model.external import ardupilot_process, betaflight_process, px4_process  # with all of MAVLink

    finders = {
        "px4": px4_process.find_build,
        "ardupilot": ardupilot_process.find_build,
        "betaflight": betaflight_process.find_binary,
    }
    return finders[kind](given)


def fly_external(
    plan: ExternalPlan,
    out: Path,
    *,
    tlog: bool = False,
    progress: Callable[[float], None] | None = None,
    on_listening: Callable[[Path], None] | None = None,
) -> Flight:
    """Fly a real autopilot, leave the journal and the autopilot's folder in `out`, and return the flight.

    With `tlog` the traffic between pilot and autopilot is left beside the journal. `on_listening` is called with the
    journal before the autopilot starts. `progress` is called with the fraction flown, 0..1. No process is left behind.

    Raises
    ------
    ConfigError
        If the build, the parameters or the scenario can't be flown, a file exists already, or only a bag or a table
        names the autopilot.
    """
    plan.autopilot.check_given()
    check_external(plan.scenario, plan.autopilot.kind)
    check_rotors(plan.vehicle)
    build = find_build(plan.autopilot.kind, Path(plan.autopilot.build) if plan.autopilot.build else None)
    plan = plan._replace(scenario=scenario_for(plan.autopilot.kind, plan.scenario))
    out.mkdir(parents=True, exist_ok=True)
    journal, folder = out / f"{plan.name}.journal", out / f"{plan.name}.autopilot"
    if there := [path for path in (journal, folder) if path.exists()]:
        raise ConfigError(f"{there[0]}: exists already")
    with TemporaryDirectory(dir=out, prefix=WORKING_PREFIX) as inputs:
        arguments = [*_write_inputs(plan, Path(inputs), journal, folder), "--build", str(build)]
        arguments += ["--tlog", str(journal.with_suffix(".tlog"))] if tlog else []
        facts = _watch(arguments, plan.scenario.samples, journal, progress, on_listening)
    records = read_journal(journal)[1] if journal.exists() else np.empty(0, dtype=RECORD)
    estimates = read_estimates(journal.with_suffix(ATTITUDE_SUFFIX))
    outcome = blame_physics(FlightOutcome[ExternalOutcome(facts["outcome"]).name], records, plan.scenario)
    words = describe(outcome, plan.scenario, records) if outcome is FlightOutcome.DIVERGED else outcome.value
    flown = f"{plan.scenario.name}, {plan.autopilot.name}, seed {plan.seed}: {words}"
    return Flight(
        scenario=plan.scenario,
        law=None,
        vehicle=plan.vehicle,
        seed=plan.seed,
        records=records,
        outcome=outcome,
        message=f"{flown} ({facts['reason']})" if facts["reason"] else flown,
        realtime_factor=facts["realtime_factor"],
        journal=journal,
        autopilot={
            **plan.autopilot.to_dict(),
            "control_rate_hz": plan.scenario.control_rate_hz,
            "flown": facts["autopilot"],
            "reason": facts["reason"],
        },
        estimates=estimates,
    )


def _write_inputs(plan: ExternalPlan, inputs: Path, journal: Path, folder: Path) -> list[str]:
    """Write the files that the process reads, and return its arguments."""
    documents = {
        "scenario": to_jsonable_python(plan.scenario),
        "vehicle": to_jsonable_python(plan.vehicle),
        "metadata": plan.metadata(),
    }
    arguments = ["--exit-on-stdin-eof"]
    for name, document in documents.items():
        path = inputs / f"{name}.json"
        with naming(folder):
            path.write_text(json.dumps(document), encoding="utf-8")
        arguments += [f"--{name}", str(path)]
    autopilot = plan.autopilot
    arguments += ["--autopilot", autopilot.kind, "--seed", str(plan.seed)]
    arguments += ["--journal", str(journal), "--folder", str(folder)]
    options = {"--params": autopilot.parameters, "--law": autopilot.law}
    for option, value in options.items():
        arguments += [option, value] if value else []
    arguments += [] if autopilot.instance is None else ["--instance", str(autopilot.instance)]
    return [*arguments, "--real-time"] if plan.real_time else arguments


def _watch(
    arguments: list[str],
    samples: int,
    journal: Path,
    progress: Callable[[float], None] | None,
    on_listening: Callable[[Path], None] | None,
) -> Mapping[str, Any]:
    """Run the process to its end, and return the facts that it printed."""
    is_hung = False
    with launch("firmware_model.external", *arguments) as process:
        try:
            greeted = bool(process.stdout and process.stdout.readline())
            if greeted and on_listening:
                on_listening(journal)
            is_hung = not _wait_for_end(process, samples, journal, progress or (lambda _: None))
        except KeyboardInterrupt:
            terminate(process)
        finally:
            terminate(process)
        return _hung_facts() if is_hung else _read_facts(process)


def _wait_for_end(
    process: "subprocess.Popen[str]", samples: int, journal: Path, progress: Callable[[float], None]
) -> bool:
    """Wait until a process has ended; return False as soon as its journal has not grown for `_STILL_S`."""
    grown_s, before = time.monotonic(), 0
    while process.poll() is None:
        now_s, records = time.monotonic(), count_records(journal)
        if records > before:
            grown_s, before = now_s, records
        if now_s > grown_s + _STILL_S:
            return False
        progress(min(records / samples, 1.0))
        time.sleep(_POLL_S)
    return True


def _hung_facts() -> Mapping[str, Any]:
    """Return the facts of a process that was ended because it did nothing."""
    reason = f"the process that simulates for it recorded nothing for {_STILL_S:g} s"
    return {"outcome": ExternalOutcome.HUNG.value, "reason": reason, "realtime_factor": 0.0, "autopilot": {}}


def _read_facts(process: "subprocess.Popen[str]") -> Mapping[str, Any]:
    """Return the facts that an ended process printed last, or its end if it printed none."""
    printed = process.stdout.read().splitlines() if process.stdout else []
    said = process.stderr.read().strip().splitlines() if process.stderr else []
    if process.returncode == _BAD_INPUT:
        raise ConfigError(said[-1].removeprefix("external: ") if said else "the autopilot's process did not start")
    if printed:
        facts: dict[str, Any] = json.loads(printed[-1])
        return facts
    reason = said[-1] if said else "the process that simulates for the autopilot ended"
    return {"outcome": ExternalOutcome.KILLED.value, "reason": reason, "realtime_factor": 0.0, "autopilot": {}}
