"""A flight as two processes joined by UDP alone.

    python -m firmware_model  <== datagrams ==>  python -m gustproof.flight.endpoint

The vehicle's process leaves the journal; law, scenario and seed give the same bits as `loopback.fly_loopback`.
"""

import contextlib
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self

import numpy as np
from pydantic_core import to_jsonable_python

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.errors import ConfigError, naming
from firmware_model.process.child import share_core
from firmware_model.process.fork import can_fork, run_in_copy
from firmware_model.recording.journal import count_records, read_journal, record_type
from firmware_model.session.outcome import VehicleOutcome as VehicleOutcome
from gustproof.flight.controllers.external_autopilot import ExternalAutopilot
from gustproof.flight.controllers.user_controller import Controller
from gustproof.flight.endpoint.guard import describe_exit
from gustproof.flight.routes.flight import Flight, FlightPlan, kill_schedule
from gustproof.flight.routes.outcome import FlightOutcome, blame_physics, describe
from gustproof.flight.routes.programs import controller_command, describe_start, is_program, refine_outcome
from gustproof.flight.scoring.metrics import measure
from gustproof.flight.scoring.requirements import judge
from gustproof.law.form import Law, find_vehicle
from gustproof.law.references import describe_other_rate

WORKING_PREFIX = ".flight-"
"""Prefix of the folder of input files for the processes, inside the flight's; a killed starter leaves it behind."""
_POLL_S = 0.02  # between two looks at the processes
_BAD_INPUT = 2  # exit status of our own controller
_EXIT_TIMEOUT_S = 5.0  # for a process to end by itself
_UNBORN_S = 0.2  # for one that has nothing to save, and hears no signal while it compiles
_ORPHAN_TIMEOUT_S = 10.0  # for a vehicle to begin its flight without its controller
_START_TIMEOUT_S = 60.0  # for a controller to begin the flight
_OUTCOMES = {
    VehicleOutcome.DONE: FlightOutcome.DONE,
    VehicleOutcome.STREAM_LOST: FlightOutcome.CONTROLLER_LOST,
    VehicleOutcome.LEFT_OFFBOARD: FlightOutcome.LEFT_OFFBOARD,
    VehicleOutcome.NO_CONTROLLER: FlightOutcome.NOT_STARTED,
    VehicleOutcome.INTERRUPTED: FlightOutcome.AUTOPILOT_LOST,
}


def fly(
    scenario: Scenario,
    controller: Controller,
    *,
    vehicle: Vehicle | None = None,
    seed: int = 1,
    out: Path | None = None,
    real_time: bool = False,
    default_ports: bool = True,
    progress: Callable[[float], None] | None = None,
    tlog: bool = False,
    on_listening: Callable[[int, Path], None] | None = None,
) -> Flight:
    """Fly a scenario with two processes, leave the journal in the folder `out`, and return the flight.

    Without `out` no file is left. Without `vehicle` it is the shipped one that the law was made for. The journal's
    header holds the plan's metadata. With `tlog` the MAVLink traffic is left beside it.

    In lockstep the processes use a free port. In real time the vehicle uses its usual ones, so that ground stations can
    watch, unless `default_ports` is false. When the vehicle listens, `on_listening` is called with the ground stations'
    port and the journal; the flight begins after that. `progress` is called with the fraction flown, 0..1. No process
    is left behind, whatever happens.

    Raises
    ------
    ConfigError
        If the law steps at another rate than the scenario, a port is in use, or the journal or log exists already.
    ValueError
        If no vehicle is given, and the controller is no law of a shipped one.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from gustproof import fly, load_law, load_scenario
    >>> flight = fly(replace(load_scenario("paper-turbulence"), duration_s=0.1), load_law("hinf-d1"))
    >>> (flight.outcome.name, flight.vehicle.name, len(flight.records))
    ('DONE', 'paper', 25)
    """
    plan = FlightPlan(scenario, controller, find_vehicle(controller, vehicle, scenario), seed, real_time)
    options: dict[str, Any] = {"default_ports": default_ports, "progress": progress, "on_listening": on_listening}
    if out is not None:
        return fly_plan(plan, out, tlog=tlog, **options)
    with TemporaryDirectory(prefix="gustproof-") as folder:  # a long journal stays mapped after its file has gone
        return replace(fly_plan(plan, Path(folder), **options), journal=None)


def fly_plan(
    plan: FlightPlan,
    out: Path,
    *,
    default_ports: bool = True,
    progress: Callable[[float], None] | None = None,
    tlog: bool = False,
    on_listening: Callable[[int, Path], None] | None = None,
) -> Flight:
    """Fly a plan as `fly` does; that of a real autopilot is for `external.fly_external`."""
    scenario, controller, vehicle, seed, real_time, _ = plan
    if isinstance(controller, ExternalAutopilot):
        raise TypeError(f"'{controller.name}' is a real autopilot: fly it by external.fly_external")
    _check_rate(scenario, controller)
    out.mkdir(parents=True, exist_ok=True)
    journal, log = (out / f"{plan.name}.{kind}" for kind in ("journal", "tlog"))
    if there := [file for file in (journal, log) if file.exists()]:
        raise ConfigError(f"{there[0]}: exists already")
    with TemporaryDirectory(dir=out, prefix=WORKING_PREFIX) as folder:
        files = write_inputs(plan, Path(folder))
        pacing = [] if real_time else ["--lockstep"]
        ports = [] if real_time and default_ports else ["--bind-port", "0"]
        logged = ["--tlog", str(log)] if tlog else []
        options = [*pacing, *ports, *logged]
        pair = _ProcessPair(files, plan, controller, journal, options)
        try:
            with pair:
                outcome = pair.fly(scenario.samples, progress or (lambda _: None), on_listening or (lambda *_: None))
        except ConfigError:
            if pair.listened:  # else it made no journal: one that is there is another process's
                _remove_unflown(journal, log, vehicle.rotors.count)
            raise
    summary = pair.summary
    records = (
        read_journal(journal)[1] if journal.exists() else np.empty(0, dtype=record_type(plan.vehicle.rotors.count))
    )
    outcome = blame_physics(outcome, records, scenario)
    words = describe(outcome, scenario, records)
    reason = f" ({pair.reason})" if pair.reason and words == outcome.value else ""
    return Flight(
        scenario=scenario, controller=controller, vehicle=vehicle, seed=seed, records=records, outcome=outcome,
        message=f"{scenario.name}, {controller.name}, seed {seed}: {words}{reason}",
        realtime_factor=summary.get("realtime_factor", 0.0), counters=summary.get("counters", {}),
        timing=summary.get("pace"), link=summary.get("link_faults", {}), journal=journal, nominal=plan.nominal,
    )  # fmt: skip


def _remove_unflown(journal: Path, log: Path, rotors: int) -> None:
    """Remove the files of a flight that was refused before its first sample."""
    if not (journal.exists() and count_records(journal, rotors)):
        for file in (journal, log):
            file.unlink(missing_ok=True)


def _check_rate(scenario: Scenario, controller: Controller) -> None:
    """Check that a law steps at the scenario's rate; the process of a user's controller checks its own."""
    if isinstance(controller, Law) and (line := describe_other_rate(scenario, controller.name, controller.dt)):
        raise ConfigError(line)


def write_inputs(plan: FlightPlan, folder: Path) -> dict[str, Path]:
    """Write the files that the processes read, and return their paths by content; an error names the folder above."""
    files = {name: folder / f"{name}.json" for name in ("scenario", "vehicle", "nominal", "law", "note")}
    with naming(folder.parent):
        files["scenario"].write_text(json.dumps(to_jsonable_python(plan.scenario)), encoding="utf-8")
        files["vehicle"].write_text(json.dumps(to_jsonable_python(plan.vehicle)), encoding="utf-8")
        files["nominal"].write_text(json.dumps(to_jsonable_python(plan.nominal or plan.vehicle)), encoding="utf-8")
        files["note"].write_text(json.dumps(plan.metadata()), encoding="utf-8")
        if isinstance(plan.controller, Law):
            plan.controller.save(files["law"])
    return files


def _load_scoring(plan: FlightPlan) -> None:
    """Load or compile the machine code that measures a flight, and judges it."""
    records = np.zeros(2, dtype=record_type(plan.vehicle.rotors.count))
    measure(records, plan.vehicle, plan.scenario)
    judge(records, plan.scenario, plan.vehicle)


class _ProcessPair:
    """Vehicle and controller of a flight, each a process, and a spare controller if the script kills that one."""

    def __init__(
        self, files: dict[str, Path], plan: FlightPlan, controller: Controller, journal: Path, options: list[str]
    ) -> None:
        self.summary: dict[str, Any] = {}
        self.reason = ""
        self.listened = False
        self._gave_up = self._alone = False
        self._plan, self._files, self._journal, self._options = plan, files, journal, options
        self._rotors = plan.vehicle.rotors.count
        self._kill, self._replaced, self._address = kill_schedule(plan.scenario), False, ""
        self._is_program = is_program(controller)
        self._is_law = isinstance(controller, Law)
        self._controller = controller_command(
            controller, files, real_time=plan.real_time, level=not plan.scenario.references
        )
        self._scripted = plan.scenario.has_link_script
        self._processes: dict[str, subprocess.Popen[str]] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._processes.values():
            close(process)

    def fly(
        self, samples: int, progress: Callable[[float], None], on_listening: Callable[[int, Path], None]
    ) -> FlightOutcome:
        """Start both processes, watch them to the end, and return the outcome."""
        try:
            self._launch()
            progress(0.0)
            self._begin(on_listening)
            self._watch(samples, progress)
        except KeyboardInterrupt:
            for process in self._processes.values():
                terminate(process, _EXIT_TIMEOUT_S if self.listened else _UNBORN_S)
            return FlightOutcome.INTERRUPTED
        return self._read_outcome()

    def _launch(self) -> None:
        """Start the processes; nothing may have started a thread before, or they can't be copies of this one."""
        self._processes["vehicle"] = launch(
            "firmware_model", "--json", "--exit-on-stdin-eof", *self._options, "--seed", str(self._plan.seed),
            "--journal", str(self._journal), "--metadata", str(self._files["note"]),
            "--scenario", str(self._files["scenario"]), "--vehicle", str(self._files["vehicle"]),
            copied=not self._plan.real_time,
        )  # fmt: skip
        # The controller starts meanwhile; it gets the port once the vehicle has one.
        for name in ("controller", "spare") if self._kill is not None else ("controller",):
            self._processes[name] = launch(*self._controller, copied=self._is_law and not self._plan.real_time)

    def _begin(self, on_listening: Callable[[int, Path], None]) -> None:
        """Let the controller begin, once the vehicle listens."""
        vehicle = self._processes["vehicle"]
        _load_scoring(self._plan)  # meanwhile, instead of after the flight
        greeting = vehicle.stdout.readline() if vehicle.stdout else ""
        if not greeting:
            raise ConfigError(last_stderr_line(self._processes["vehicle"]) or "the vehicle's process did not start")
        self.listened = True
        ports = json.loads(greeting)["listening"]
        on_listening(ports[0], self._journal)
        self._address = f"127.0.0.1:{ports[-1]}"
        if "--lockstep" in self._options:
            share_core([process.pid for process in self._processes.values()])
        self._send_address()

    def _send_address(self) -> None:
        """Let the controller begin; `_watch` finds one that has ended already."""
        send_line(self._processes["controller"], self._address)

    def _follow_script(self, flown: int) -> None:
        """Kill the controller when the script says so, and let the spare one take its place."""
        if self._kill is None or flown < self._kill[0]:
            return
        # A guard kills its program and all that it has started; it would outlive them if it were killed itself.
        self._processes["controller"].send_signal(signal.SIGQUIT if self._is_program else signal.SIGKILL)
        if flown >= self._kill[1]:
            self._processes["dead"] = self._processes["controller"]
            self._processes["controller"] = self._processes.pop("spare")
            self._kill, self._replaced = None, True
            self._send_address()

    def _watch(self, samples: int, progress: Callable[[float], None]) -> None:
        """Wait until the vehicle has ended; end it if its controller ended before the flight began."""
        vehicle = self._processes["vehicle"]
        alone_since, give_up_s = None, time.monotonic() + _START_TIMEOUT_S
        while vehicle.poll() is None:
            flown = count_records(self._journal, self._rotors)
            self._follow_script(flown)
            progress(min(flown / samples, 1.0))
            if self._processes["controller"].poll() is not None:
                self._check_entry(flown)
                alone_since = alone_since or time.monotonic()
                give_up_s = min(give_up_s, alone_since + _ORPHAN_TIMEOUT_S)
            if not flown and time.monotonic() > give_up_s:
                self._gave_up = True
                terminate(vehicle)
            time.sleep(_POLL_S)
        self._alone = self._processes["controller"].poll() is not None
        with contextlib.suppress(subprocess.TimeoutExpired):
            # A spare controller took over a flying vehicle: it does not end with this flight.
            ends = vehicle.returncode == 0 and not self._replaced
            self._processes["controller"].wait(_EXIT_TIMEOUT_S if ends else 0.0)
        progress(min(count_records(self._journal, self._rotors) / samples, 1.0))

    def _check_entry(self, flown: int) -> None:
        """Refuse an object or a library that can't be made; its process says why."""
        controller = self._processes["controller"]
        is_refused = controller.returncode == _BAD_INPUT and not (flown or self._is_law or self._is_program)
        if is_refused and (line := last_stderr_line(controller)):
            raise ConfigError(line.removeprefix("gustproof controller: "))

    def _read_outcome(self) -> FlightOutcome:
        """Return the outcome; keep the vehicle's summary, and the reason of a flight that broke off."""
        self.summary = read_summary(self._processes["vehicle"])
        if not self.summary:
            self.reason = last_stderr_line(self._processes["vehicle"])
            return FlightOutcome.AUTOPILOT_LOST
        outcome = FlightOutcome.NOT_STARTED if self._gave_up else _OUTCOMES[VehicleOutcome(self.summary["outcome"])]
        status = self._processes["controller"].poll()
        reason, reported = self._read_controller()
        # A program ends by itself once the vehicle is disarmed, whatever the outcome.
        ended_early = self._alone if self._is_program else status is not None
        if ended_early and outcome is not FlightOutcome.DONE:
            self.reason = reason or describe_exit(status or 0)
        return self._refine(outcome, reported)

    def _read_controller(self) -> tuple[str, dict[str, Any]]:
        """End the controller; return its last words, and its summary, whose figures of pace go with the vehicle's."""
        controller = self._processes["controller"]
        reason, reported = last_stderr_line(controller), read_summary(controller)
        if self.summary["pace"] and "late_samples" in reported:
            self.summary["pace"] |= {name: reported[name] for name in ("late_samples", "missed_samples")}
        if reported:
            reason = f"{'gustproof controller: ' if self._is_law else ''}{reported['message']}"
        return reason, reported

    def _refine(self, outcome: FlightOutcome, reported: Mapping[str, Any]) -> FlightOutcome:
        """Return the outcome with a user's controller, and keep how far one came that did not begin; a law's stays."""
        if self._is_law:
            return outcome
        if outcome is FlightOutcome.NOT_STARTED:
            self.reason = "; ".join(filter(None, (describe_start(self.summary), self.reason)))
        return outcome if self._scripted else refine_outcome(outcome, self.summary, reported, alone=self._alone)


def launch(module: str, *arguments: str, copied: bool = False) -> "subprocess.Popen[str]":
    """Start a module of this Python, with pipes for its streams.

    It has a session of its own: Ctrl-C reaches this process alone, which then ends it in order. If this process is
    killed, its standard input ends, and so does it. The current folder is not on its path: a file there that has the
    name of a module must not run. If it is `copied`, and can be, it need not import what this process has imported.
    """
    copy = None
    if copied and can_fork():
        main = import_module(f"{module}.__main__").main  # here, so that who starts no copy need not load it
        copy = run_in_copy(module.rpartition(".")[2], main, arguments)
    return subprocess.Popen(
        [sys.executable, "-P", "-m", module, *arguments], preexec_fn=copy,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip


def send_line(process: "subprocess.Popen[str]", line: str) -> None:
    """Write a line to the standard input of a process, which may have ended."""
    with contextlib.suppress(BrokenPipeError):
        if process.stdin:
            process.stdin.write(f"{line}\n")
            process.stdin.flush()


def read_summary(process: "subprocess.Popen[str]") -> dict[str, Any]:
    """Return the JSON that an ended process printed last; empty if it was killed."""
    lines = process.stdout.read().splitlines() if process.stdout else []
    return json.loads(lines[-1]) if lines else {}


def last_stderr_line(process: "subprocess.Popen[str]") -> str:
    """End a process, and return the last line that it left on stderr."""
    terminate(process)
    lines = process.stderr.read().strip().splitlines() if process.stderr else []
    return lines[-1] if lines else ""


def close(process: "subprocess.Popen[str]") -> None:
    """End a process, and close its streams."""
    terminate(process)
    for stream in (process.stdin, process.stdout, process.stderr):
        with contextlib.suppress(BrokenPipeError):
            if stream:
                stream.close()


def terminate(process: "subprocess.Popen[str]", wait_s: float = _EXIT_TIMEOUT_S) -> None:
    """End a process, with SIGTERM first, so that it can close its files, and by force after `wait_s` [s]."""
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(wait_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
