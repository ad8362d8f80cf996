"""A flight as two processes joined by UDP alone, and the same flight over loopback in one process.

    fly           python -m firmware_model  <== datagrams ==>  python -m gustproof.controller
    fly_loopback  VehicleEndpoint           <-- handed over -->  ControllerEndpoint, on a virtual clock

Both leave the vehicle's journal; the same law, scenario and seed give the same bits on either.
"""

import contextlib
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic_core import to_jsonable_python

from firmware_model.config.events import ControllerKill
from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.errors import ConfigError
from firmware_model.recording.journal import RECORD, count_records, read_journal
from firmware_model.session.outcome import VehicleOutcome as VehicleOutcome
from firmware_model.session.vehicle_endpoint import VehicleEndpoint
from firmware_model.types import NEVER_US
from gustproof.controller.endpoint import ControllerEndpoint
from gustproof.law.form import Law
from gustproof.simulate.outcome import FlightOutcome, describe

WORKING_PREFIX = ".flight-"
"""How the folder of what the processes read begins, in the flight's own; a starter that was killed leaves it behind."""
_POLL_S = 0.02  # how often the processes are looked after
_EXIT_TIMEOUT_S = 5.0  # how long a process may take to end by itself
_ORPHAN_TIMEOUT_S = 10.0  # how long a vehicle may take to show that it flies on without its controller
_VEHICLE, _CONTROLLER, _SPARE = (0, ("vehicle", 1)), (0, ("controller", 1)), (0, ("controller", 2))

Records = NDArray[np.void]


_OUTCOMES = {
    VehicleOutcome.DONE: FlightOutcome.DONE,
    VehicleOutcome.STREAM_LOST: FlightOutcome.CONTROLLER_LOST,
    VehicleOutcome.LEFT_OFFBOARD: FlightOutcome.LEFT_OFFBOARD,
    VehicleOutcome.NO_CONTROLLER: FlightOutcome.NOT_STARTED,
    VehicleOutcome.INTERRUPTED: FlightOutcome.AUTOPILOT_LOST,
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FlightResult:
    """What a flight left behind."""

    scenario: Scenario
    """Script that was flown."""
    law: Law
    """Law that flew it."""
    vehicle: Vehicle
    """Vehicle that was flown."""
    seed: int
    """Seed of gusts and noise."""
    records: Records
    """(n,) the journal's records; fewer than the scenario has samples if the flight broke off."""
    outcome: FlightOutcome
    """How it ended."""
    message: str
    """One line on how it ended, for people."""
    realtime_factor: float
    """[-] simulated time over wall time from t = 0 to landing; 0 if unknown."""
    counters: dict[str, int]
    """What went other than planned on the vehicle's side, by cause."""
    pace: dict[str, Any] | None
    """How well the deadlines were kept: missed ones, set-points held, delays [us], and the samples that the law stepped
    late and never got, as far as its controller lived to tell; `None` in lockstep, and unknown."""
    link: dict[str, dict[str, int]]
    """What the faults of the link did, by direction; empty if the script has none."""
    journal: Path
    """File of the records."""


def fly(
    scenario: Scenario,
    law: Law,
    *,
    vehicle: Vehicle,
    seed: int = 1,
    out: Path,
    real_time: bool = False,
    default_ports: bool = True,
    progress: Callable[[float], None] | None = None,
    note: Mapping[str, Any] | None = None,
    tlog: bool = False,
    watched: Callable[[int, Path], None] | None = None,
) -> FlightResult:
    """Fly a scenario with two processes, leave the journal in the folder `out`, and return what was flown.

    The journal's header has `note`. With `tlog` the MAVLink traffic is left beside it.

    In lockstep the processes use a free port; in real time those of the vehicle are the usual ones, so that ground
    stations can watch, unless `default_ports` is false. `watched` is told the ground stations' port and the journal when
    the vehicle listens, and the flight begins after that; `progress` is told the fraction flown, 0..1. No process is
    left behind, whatever happens.

    Raises
    ------
    ConfigError
        If the law steps at another rate than the scenario, a port is in use, or the journal or log exists already.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from gustproof import fly, load_law, load_scenario, load_vehicle
    >>> scenario = replace(load_scenario("paper-turbulence"), duration_s=0.1)
    >>> with TemporaryDirectory() as folder:
    ...     flight = fly(scenario, load_law("hinf-d1"), vehicle=load_vehicle("paper"), out=Path(folder))
    >>> (flight.outcome.name, len(flight.records))
    ('DONE', 25)
    """
    if law.dt != scenario.dt:
        raise ConfigError(f"law '{law.name}' steps every {law.dt} s, scenario '{scenario.name}' every {scenario.dt} s")
    out.mkdir(parents=True, exist_ok=True)
    journal, log = (out / f"{scenario.name}-{law.name}-seed{seed}.{kind}" for kind in ("journal", "tlog"))
    for file in (journal, log):
        if file.exists():
            raise ConfigError(f"{file}: exists already")
    with TemporaryDirectory(dir=out, prefix=WORKING_PREFIX) as folder:
        files = {name: Path(folder) / f"{name}.json" for name in ("scenario", "vehicle", "law", "note")}
        files["scenario"].write_text(json.dumps(to_jsonable_python(scenario)), encoding="utf-8")
        files["vehicle"].write_text(json.dumps(to_jsonable_python(vehicle)), encoding="utf-8")
        files["note"].write_text(json.dumps(note), encoding="utf-8")
        law.save(files["law"])
        pace = [] if real_time else ["--lockstep"]
        ports = [] if real_time and default_ports else ["--bind-port", "0"]
        logged = ["--tlog", str(log)] if tlog else []
        with _ProcessPair(files, seed, journal, [*pace, *ports, *logged], _controller_kill(scenario)) as pair:
            outcome = pair.fly(scenario.samples, progress or (lambda _: None), watched or (lambda *_: None))
    told = pair.told
    records = read_journal(journal)[1] if journal.exists() else np.empty(0, dtype=RECORD)
    words = describe(outcome, scenario, records)
    reason = pair.reason if words == outcome.value else ""
    return FlightResult(
        scenario=scenario, law=law, vehicle=vehicle, seed=seed, records=records, outcome=outcome,
        message=f"{scenario.name}, {law.name}, seed {seed}: {words}{reason}",
        realtime_factor=told.get("realtime_factor", 0.0), counters=told.get("counters", {}),
        pace=told.get("pace"), link=told.get("link_faults", {}), journal=journal,
    )  # fmt: skip


def fly_loopback(scenario: Scenario, law: Law, *, vehicle: Vehicle, seed: int = 1) -> Records:
    """Fly a scenario in lockstep over datagrams that never leave this process, on a virtual clock.

    Returns the journal's records (n,); the protocol cores are those of the two processes.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from gustproof import fly_direct, fly_loopback, load_law, load_scenario, load_vehicle
    >>> scenario = replace(load_scenario("paper-turbulence"), duration_s=0.1)
    >>> law, vehicle = load_law("hinf-d1"), load_vehicle("paper")
    >>> fly_loopback(scenario, law, vehicle=vehicle).tobytes() == fly_direct(scenario, law, vehicle=vehicle).tobytes()
    True
    """
    rows: list[NDArray[np.float64]] = []
    autopilot = VehicleEndpoint(vehicle, scenario, seed, lambda row: rows.append(row.copy()), lockstep=True)
    controller, peer = ControllerEndpoint(law, _VEHICLE, references=scenario.references), _CONTROLLER
    killing = _controller_kill(scenario)
    now_us = 0
    while not autopilot.finished:
        sent = autopilot.poll(now_us)
        if killing is not None and len(rows) >= killing.back:
            controller = ControllerEndpoint(law, _VEHICLE, references=scenario.references)
            peer, killing = _SPARE, None
        dead = controller.finished or (killing is not None and len(rows) >= killing.sample)
        for datagram, address in sent:
            if address == peer and not dead:
                controller.receive(datagram, _VEHICLE, now_us)
        answers = [] if dead else controller.poll(now_us)
        for datagram, _ in answers:
            autopilot.receive(datagram, peer, now_us)
        if not sent and not answers:
            now_us = max(now_us + 1, min(autopilot.deadline_us(), NEVER_US if dead else controller.deadline_us()))
    return np.array(rows).reshape(len(rows), -1).view(RECORD)[:, 0] if rows else np.empty(0, dtype=RECORD)


class _ControllerKill(NamedTuple):
    """When the script kills the controller, and when another one takes its place, in samples flown."""

    sample: int
    back: float


def _controller_kill(scenario: Scenario) -> _ControllerKill | None:
    """Return when the controller is killed, if it is; `back` is infinite if that is its end."""
    for item in scenario.event:
        if isinstance(item, ControllerKill):
            away_s, rate_hz = item.recovers_after_s, scenario.control_rate_hz
            back = math.inf if away_s is None else round((item.at_s + away_s) * rate_hz)
            return _ControllerKill(round(item.at_s * rate_hz), back)
    return None


class _ProcessPair:
    """The processes of a flight: vehicle, controller, and a spare one if the script kills that; in the end, none."""

    def __init__(
        self, files: dict[str, Path], seed: int, journal: Path, options: list[str], killing: _ControllerKill | None
    ) -> None:
        self.told: dict[str, Any] = {}
        self.reason = ""
        self._gave_up = False
        self._files, self._seed, self._journal, self._options = files, seed, journal, options
        self._killing, self._replaced, self._address = killing, False, ""
        self._pace = [] if "--lockstep" in options else ["--real-time"]
        self._processes: dict[str, subprocess.Popen[str]] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in self._processes.values():
            _terminate(process)
            for stream in (process.stdin, process.stdout, process.stderr):
                with contextlib.suppress(BrokenPipeError):
                    if stream:
                        stream.close()

    def fly(
        self, samples: int, progress: Callable[[float], None], watched: Callable[[int, Path], None]
    ) -> FlightOutcome:
        """Start both, watch them to the end, and say how it ended."""
        try:
            self._start(watched)
            self._watch(samples, progress)
        except KeyboardInterrupt:
            for process in self._processes.values():
                _terminate(process)
            return FlightOutcome.INTERRUPTED
        return self._outcome()

    def _start(self, watched: Callable[[int, Path], None]) -> None:
        vehicle = self._launch(
            "vehicle", "firmware_model", "--json", "--exit-on-stdin-eof", *self._options, "--seed", str(self._seed),
            "--journal", str(self._journal), "--metadata", str(self._files["note"]),
            "--scenario", str(self._files["scenario"]), "--vehicle", str(self._files["vehicle"]),
        )  # fmt: skip
        # The controller starts meanwhile, and is told the port when the vehicle has one.
        self._launch_controller("controller")
        if self._killing is not None:
            self._launch_controller("spare")
        greeting = vehicle.stdout.readline() if vehicle.stdout else ""
        if not greeting:
            raise ConfigError(self._last_stderr_line("vehicle") or "the vehicle's process did not start")
        ports = json.loads(greeting)["listening"]
        watched(ports[0], self._journal)
        self._address = f"127.0.0.1:{ports[-1]}\n"
        if "--lockstep" in self._options:
            _share_core([process.pid for process in self._processes.values()])
        self._send_address("controller")

    def _launch_controller(self, name: str) -> None:
        self._launch(
            name, "gustproof.controller", "--json", "--exit-on-stdin-eof", "--law", str(self._files["law"]), "--connect", "-",
            "--scenario", str(self._files["scenario"]), "--anyway", *self._pace,
        )  # fmt: skip

    def _send_address(self, name: str) -> None:
        """Let a controller begin; one that has ended already is found out by the watch."""
        stdin = self._processes[name].stdin
        with contextlib.suppress(BrokenPipeError):
            if stdin:
                stdin.write(self._address)
                stdin.flush()

    def _follow_script(self, flown: int) -> None:
        """Kill the controller when the script says so, and let the spare one take its place."""
        if self._killing is None or flown < self._killing.sample:
            return
        self._processes["controller"].kill()
        if flown >= self._killing.back:
            self._processes["dead"] = self._processes["controller"]
            self._processes["controller"] = self._processes.pop("spare")
            self._killing, self._replaced = None, True
            self._send_address("controller")

    def _launch(self, name: str, module: str, *arguments: str) -> subprocess.Popen[str]:
        # A session of its own: Ctrl-C reaches this process alone, which then ends both in order. If it is killed,
        # their standard input ends, and they do.
        self._processes[name] = process = subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        )  # fmt: skip
        return process

    def _watch(self, samples: int, progress: Callable[[float], None]) -> None:
        """Wait until the vehicle has ended; end it if its controller did before anything was flown."""
        vehicle = self._processes["vehicle"]
        alone_since = None
        while vehicle.poll() is None:
            flown = count_records(self._journal)
            self._follow_script(flown)
            progress(min(flown / samples, 1.0))
            if self._processes["controller"].poll() is not None:
                alone_since = alone_since or time.monotonic()
                if not flown and time.monotonic() > alone_since + _ORPHAN_TIMEOUT_S:
                    self._gave_up = True
                    _terminate(vehicle)
            time.sleep(_POLL_S)
        with contextlib.suppress(subprocess.TimeoutExpired):
            # One that took a flying vehicle over does not end with this flight.
            ends = vehicle.returncode == 0 and not self._replaced
            self._processes["controller"].wait(_EXIT_TIMEOUT_S if ends else 0.0)
        progress(min(count_records(self._journal) / samples, 1.0))

    def _outcome(self) -> FlightOutcome:
        self.told = self._document("vehicle")
        if not self.told:
            self.reason = _format_reason(self._last_stderr_line("vehicle"))
            return FlightOutcome.AUTOPILOT_LOST
        outcome = FlightOutcome.NOT_STARTED if self._gave_up else _OUTCOMES[VehicleOutcome(self.told["outcome"])]
        alone = self._processes["controller"].poll() is not None
        reason = self._last_stderr_line("controller")
        if told := self._document("controller"):
            reason = f"gustproof controller: {told['message']}"
            if self.told["pace"]:
                self.told["pace"] |= {name: told[name] for name in ("late_samples", "missed_samples")}
        if outcome is not FlightOutcome.DONE and alone:
            self.reason = _format_reason(reason)
        return outcome

    def _document(self, name: str) -> dict[str, Any]:
        """Return what an ended process told as JSON in the end, nothing if it was killed."""
        stdout = self._processes[name].stdout
        lines = stdout.read().splitlines() if stdout else []
        return json.loads(lines[-1]) if lines else {}

    def _last_stderr_line(self, name: str) -> str:
        """Return the last line that an ended process left on stderr."""
        process = self._processes[name]
        _terminate(process)
        lines = process.stderr.read().strip().splitlines() if process.stderr else []
        return lines[-1] if lines else ""


def _format_reason(reason: str) -> str:
    return f" ({reason})" if reason else ""


def _share_core(pids: list[int]) -> None:
    """Let processes that take turns share the core that the first is on: to wake another core takes longer."""
    with contextlib.suppress(OSError, AttributeError):  # where there is no such call, nothing is done
        fields = Path(f"/proc/{pids[0]}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        for pid in pids:
            os.sched_setaffinity(pid, (int(fields[36]),))  # the core that it ran on last


def _terminate(process: subprocess.Popen[str]) -> None:
    """End a process: first by asking, so that it can close its files."""
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(_EXIT_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
