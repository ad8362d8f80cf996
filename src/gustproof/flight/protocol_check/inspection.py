"""Check a controller: start it against a vehicle, in lockstep and in real time, and report what is wrong by name."""

import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from firmware_model.autopilot.modes import Mode
from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.config.waveforms import MomentStep
from firmware_model.process import udp
from firmware_model.session.outcome import VehicleOutcome
from firmware_model.session.vehicle_endpoint import VehicleEndpoint
from firmware_model.sim.vehicle_loop import VehicleLoop
from firmware_model.types import LevelFlight
from gustproof.flight.controllers.user_controller import Controller
from gustproof.flight.protocol_check.findings import DURATION_S, KICK_RATE, KICK_S, Finding, Trial, judge
from gustproof.flight.protocol_check.witness import Witness
from gustproof.flight.routes.flight import FlightPlan
from gustproof.flight.routes.processes import close, last_stderr_line, launch, read_summary, send_line, write_inputs
from gustproof.flight.routes.programs import controller_command
from gustproof.law.form import Law

PATIENCE_S = 8.0
"""[s] wall time from a controller's first message to the start of the flight."""
STARTUP_S = 30.0
"""[s] wall time from the start of a controller's process to its first message."""


def check_controller(
    controller: Controller,
    *,
    vehicle: Vehicle,
    patience_s: float = PATIENCE_S,
    progress: Callable[[float, str], None] = lambda *_: None,
) -> list[Finding]:
    """Return what is wrong with a controller, by name; nothing if it keeps to the protocol.

    It flies twice for some seconds in calm air: in lockstep, where a few of its answers are lost on purpose, and in
    real time. A kick turns the vehicle, so that units and signs show in the response. The second flight is left out
    if the first one did not reach its end. `progress` is called with a fraction and the flight's name.

    Raises
    ------
    ConfigError
        If the controller can't be started.
    """
    script = _script(vehicle, controller)
    # Load or compile the machine code before a controller waits for it.
    VehicleLoop(vehicle, script, 1).advance(LevelFlight(), Mode.STABILIZED.value)
    found: list[Finding] = []
    for number, name in enumerate(("lockstep", "real time")):
        progress(number / 2, name)
        trial = _fly_trial(name, script, controller, vehicle, patience_s=patience_s)
        known = {finding.name for finding in found}
        found += [finding for finding in judge(trial) if finding.name not in known]
        if trial.witness.vehicle.outcome is not VehicleOutcome.DONE and not trial.witness.is_slow:
            break
    progress(1.0, "done")
    return found


def _script(vehicle: Vehicle, controller: Controller) -> Scenario:
    """Return the scenario of a trial: calm air, and a kick about all axes, at the rate of the law."""
    begin_s, end_s = KICK_S
    roll, pitch, yaw = (inertia * KICK_RATE / (end_s - begin_s) for inertia in vehicle.inertia_B)
    kick = (
        MomentStep(kind="step", amplitude_nm=(roll, pitch, yaw), start_s=begin_s),
        MomentStep(kind="step", amplitude_nm=(-roll, -pitch, -yaw), start_s=end_s),
    )
    script = replace(load_scenario("calm"), name="check", duration_s=DURATION_S, moment=kick)
    if not isinstance(controller, Law):
        return script
    rate_hz = round(1.0 / controller.dt)
    steps = max(round(script.physics_rate_hz / rate_hz), 1)
    return replace(script, control_rate_hz=rate_hz, physics_rate_hz=steps * rate_hz)


def _fly_trial(name: str, script: Scenario, controller: Controller, vehicle: Vehicle, *, patience_s: float) -> Trial:
    lockstep = name == "lockstep"
    with TemporaryDirectory() as folder, udp.bind(0) as bound:
        files = write_inputs(FlightPlan(script, controller, vehicle, 1, not lockstep), Path(folder))
        process = launch(*controller_command(controller, files, real_time=not lockstep))
        try:
            send_line(process, f"127.0.0.1:{bound.getsockname()[1]}")
            endpoint = VehicleEndpoint(vehicle, script, 1, lambda _: None, lockstep=lockstep)
            witness = Witness(
                endpoint, script.sample_us, lambda: process.poll() is None, patience_s=patience_s, startup_s=STARTUP_S
            )
            if lockstep:
                udp.serve_lockstep(witness, bound)
            else:
                udp.serve(witness, [bound], real_time=True)
            ending = _describe_ending(process) if witness.died else ""
        finally:
            close(process)
    return Trial(name=name, witness=witness, ending=ending, vehicle=vehicle)


def _describe_ending(process: "subprocess.Popen[str]") -> str:
    """Return how a process ended, in words: those of its summary, or the last that it said."""
    said, summary = last_stderr_line(process), read_summary(process)
    return str(summary.get("message") or said or f"it ended with status {process.returncode}")
