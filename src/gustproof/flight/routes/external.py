"""A flight of a real autopilot in our world, by a process of its own that starts and ends the autopilot.

    python -m firmware_model.external  <== its simulator's protocol, MAVLink ==>  the autopilot

The process leaves the journal, the autopilot's own attitude beside it, and the folder that the autopilot ran in.
"""

import json
import subprocess
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from pydantic_core import to_jsonable_python

from firmware_model.config.firmware import check_rotors
from firmware_model.config.scenario import CONTROL_RATE_HZ, Scenario
from firmware_model.errors import ConfigError, naming
from firmware_model.external.interface import SAMPLE_RATES_HZ, ExternalOutcome, scenario_for
from firmware_model.recording.estimates import ATTITUDE_SUFFIX, read_estimates
from firmware_model.recording.journal import RECORD, count_records, read_journal
from gustproof.flight.controllers.external_autopilot import ExternalAutopilot
from gustproof.flight.routes.flight import Flight, FlightPlan
from gustproof.flight.routes.outcome import FlightOutcome, blame_physics, describe
from gustproof.flight.routes.processes import WORKING_PREFIX, launch, terminate

_POLL_S = 0.02
_STILL_S = 300.0
"""[s] without a record, from the start on, by which the process counts as hung: arming may take 120 s of model time."""
_BAD_INPUT = 2  # exit status of the process


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
    plan: FlightPlan,
    out: Path,
    *,
    tlog: bool = False,
    progress: Callable[[float], None] | None = None,
    on_listening: Callable[[int | None, Path], None] | None = None,
) -> Flight:
    """Fly a real autopilot, leave the journal and the autopilot's folder in `out`, and return the flight.

    With `tlog` the traffic between pilot and autopilot is left beside the journal. `on_listening` is called with the
    journal, and no port, before the autopilot starts. `progress` is called with the fraction flown, 0..1. No process
    is left behind.

    Raises
    ------
    ConfigError
        If the build, the parameters or the scenario can't be flown, a file exists already, or only a bag or a table
        names the autopilot.
    TypeError
        If the plan is that of a law or a user's controller.
    """
    autopilot = plan.controller
    if not isinstance(autopilot, ExternalAutopilot):
        raise TypeError(f"'{autopilot.name}' is no real autopilot: fly it by processes.fly_plan")
    autopilot.check_given()
    check_external(plan.scenario, autopilot.kind)
    check_rotors(plan.vehicle)
    build = find_build(autopilot.kind, Path(autopilot.build) if autopilot.build else None)
    plan = plan._replace(scenario=scenario_for(autopilot.kind, plan.scenario))
    out.mkdir(parents=True, exist_ok=True)
    journal, folder = out / f"{plan.name}.journal", out / f"{plan.name}.autopilot"
    if there := [path for path in (journal, folder) if path.exists()]:
        raise ConfigError(f"{there[0]}: exists already")
    with TemporaryDirectory(dir=out, prefix=WORKING_PREFIX) as inputs:
        arguments = [*_write_inputs(plan, autopilot, Path(inputs), journal, folder), "--build", str(build)]
        arguments += ["--tlog", str(journal.with_suffix(".tlog"))] if tlog else []
        facts = _watch(arguments, plan.scenario.samples, journal, progress, on_listening)
    records = read_journal(journal)[1] if journal.exists() else np.empty(0, dtype=RECORD)
    estimates = read_estimates(journal.with_suffix(ATTITUDE_SUFFIX))
    outcome = blame_physics(FlightOutcome[ExternalOutcome(facts["outcome"]).name], records, plan.scenario)
    words = describe(outcome, plan.scenario, records) if outcome is FlightOutcome.DIVERGED else outcome.value
    flown = f"{plan.scenario.name}, {autopilot.name}, seed {plan.seed}: {words}"
    return Flight(
        scenario=plan.scenario,
        controller=None,
        vehicle=plan.vehicle,
        seed=plan.seed,
        records=records,
        outcome=outcome,
        message=f"{flown} ({facts['reason']})" if facts["reason"] else flown,
        realtime_factor=facts["realtime_factor"],
        journal=journal,
        autopilot={
            **autopilot.to_dict(),
            "control_rate_hz": plan.scenario.control_rate_hz,
            "flown": facts["autopilot"],
            "reason": facts["reason"],
        },
        estimates=estimates,
    )


def _write_inputs(
    plan: FlightPlan, autopilot: ExternalAutopilot, inputs: Path, journal: Path, folder: Path
) -> list[str]:
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
    on_listening: Callable[[int | None, Path], None] | None,
) -> Mapping[str, Any]:
    """Run the process to its end, and return the facts that it printed."""
    is_hung = False
    with launch("firmware_model.external", *arguments) as process:
        try:
            greeted = bool(process.stdout and process.stdout.readline())
            if greeted and on_listening:
                on_listening(None, journal)
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
