"""A flight of PX4's own simulator, SIH, under commands of its motors, read from PX4's log.

While PX4 is disarmed, MAV_CMD_ACTUATOR_TEST sets the outputs that SIH reads, and no controller stands between. Four of
these commands in one datagram act from one step on. PX4's log tells SIH's state and the outputs after every step.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from functools import reduce
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as wire

from firmware_model.errors import ConfigError
from firmware_model.external.interface import ExternalError
from firmware_model.external.px4_process import BOOTED, onboard_port, reserve_instance, start_px4, write_start_files
from firmware_model.mavlink.messages import command_long_message
from firmware_model.process.child import ChildProcess
from gustproof.logs.read.ulog import read_topics
from gustproof.studies.audit.link import AutopilotLink
from gustproof.studies.audit.simulator import Array

ROTORS = 4
_MODEL = "sihsim_quadx"
_LINKS = (
    "mavlink start -x -u {port} -r 4000000 -f -m custom -o {ours}",
    "mavlink stream -r 1000 -s {stream} -u {port}",
)
_STREAM = "HIL_ACTUATOR_CONTROLS"
_LOG_FROM_BOOT = {"SDLOG_MODE": "2"}
_OUTPUTS, _MOTION = "actuator_outputs_sim", "vehicle_local_position_groundtruth"
_ATTITUDE, _RATES = "vehicle_attitude_groundtruth", "vehicle_angular_velocity_groundtruth"
_TOPICS = {_OUTPUTS: ("output",), _MOTION: ("z", "vx", "vy", "vz"), _ATTITUDE: ("q",), _RATES: ("xyz",)}
_TOPICS_FILE = Path("etc/logging/logger_topics.txt")
_HOLD_S, _REPEAT_S = 3.0, 1.0  # of PX4's clock: a command acts for the longest that PX4 allows
_SUBSCRIBE_S = 0.1
_TIMEOUT_S = 60.0
_FLOAT32 = 1e-6  # relative


class AuditPhase(NamedTuple):
    """Part of a flight, under constant commands."""

    rotors: Array
    """(4,) [0..1]; PX4 rounds them to thousandths."""
    duration: float
    """[s] at least; of a pulse to the step."""
    is_pulse: bool = False
    """True if PX4's own clock ends it, which stops the rotors."""


class Record(NamedTuple):
    """All steps of a flight, as PX4 has logged them."""

    time_us: NDArray[np.int64]
    """(n,) [us] PX4's clock."""
    rotors: Array
    """(n, 4) [0..1] commands that act from the next step on."""
    height: Array
    """(n,) [m] above the ground."""
    velocity_N: Array
    """(n, 3) [m/s]."""
    q_NB: Array
    """(n, 4) attitude, scalar first."""
    omega_B: Array
    """(n, 3) [rad/s]."""
    parameters: dict[str, float]
    """PX4's parameters."""
    sent_us: int
    """[us] PX4's clock when the commands of the last phase were sent."""


def record_flight(build: Path, parameters: Mapping[str, str], phases: Sequence[AuditPhase], speed: float) -> Record:
    """Fly phases one after another, from rest on the ground, with a process of PX4 that ends with the flight.

    `speed` is in multiples of real time, if the machine can.

    Raises
    ------
    ConfigError
        If PX4 does not start, does not take the parameters, does not do as it is told, or logs too little.
    """
    try:
        server, instance = reserve_instance()
        with server, TemporaryDirectory() as name, closing(AutopilotLink()) as link:
            folder = Path(name)
            variables = _write_files(build, folder, parameters, onboard_port(instance), link.port)
            with closing(start_px4(build, folder, instance, _MODEL, variables, speed)) as process:
                process.share_core()  # the four commands of a datagram then act together
                flight = _Flight(process, link, instance + 1)
                flight.fly(phases)
            record = _read_record(folder, flight.sent_us)
    except ExternalError as error:
        raise ConfigError(f"audit px4: {error}") from None
    for name, value in parameters.items():
        if not math.isclose(reported := record.parameters.get(name, math.nan), float(value), rel_tol=_FLOAT32):
            raise ConfigError(f"audit px4: PX4 has {name} {reported:g} where {value} was set")
    return record


class _Flight:
    """PX4's process and its link, and what PX4 last said."""

    def __init__(self, process: ChildProcess, link: AutopilotLink, system: int) -> None:
        self._process, self._link, self._system = process, link, system
        self._heard: Any = None
        self.sent_us = 0

    def fly(self, phases: Sequence[AuditPhase]) -> None:
        """Fly all phases."""
        self._wait(lambda: self._heard is not None and self._process.has_said(BOOTED), "start")
        # Motors subscribe to commands with the first one, of which they hear a quarter: it is one to let go.
        self._command(np.zeros(ROTORS), 0.0)
        self._pass(_SUBSCRIBE_S)
        for phase in phases:
            self.sent_us = self._heard.time_usec
            (self._pulse if phase.is_pulse else self._hold)(phase)

    def _hold(self, phase: AuditPhase) -> None:
        left_s = phase.duration
        while left_s > 0.0:
            self._command(phase.rotors, _HOLD_S)
            self._pass(min(left_s, _REPEAT_S))
            left_s -= _REPEAT_S

    def _pulse(self, phase: AuditPhase) -> None:
        self._command(phase.rotors, phase.duration)
        self._pass(0.5 * phase.duration)
        self._wait(lambda: not any(self._heard.controls[:ROTORS]), "end of a pulse")

    def _command(self, rotors: Array, timeout_s: float) -> None:
        test = wire.MAV_CMD_ACTUATOR_TEST
        each = enumerate(rotors.tolist(), 1)
        self._link.send(*(command_long_message(test, self._system, u, timeout_s, 0, 0, motor) for motor, u in each))

    def _pass(self, duration_s: float) -> None:
        end_us = self._heard.time_usec + 1e6 * duration_s
        self._wait(lambda: self._heard.time_usec >= end_us, "time")

    def _wait(self, done: Callable[[], bool], goal: str) -> None:
        until_s = time.monotonic() + _TIMEOUT_S
        while not done():
            if self._process.ending or time.monotonic() > until_s:
                said = self._process.describe_ending(f"has no {goal} in {_TIMEOUT_S:g} s")
                raise ConfigError(f"audit px4: PX4 {said}")
            for message in self._link.listen():
                if message.get_type() == _STREAM:
                    self._heard = message


def _write_files(build: Path, folder: Path, parameters: Mapping[str, str], port: int, ours: int) -> dict[str, str]:
    """Write parameters, links and topics of the log, in a folder that has the build's start scripts too.

    Return the variables of PX4's environment.
    """
    links = [line.format(port=port, ours=ours, stream=_STREAM) for line in _LINKS]
    variables = write_start_files(build, folder, {**_LOG_FROM_BOOT, **parameters}, links)
    topics = folder / _TOPICS_FILE
    topics.parent.mkdir(parents=True)
    topics.write_text("".join(f"{name} 0\n" for name in _TOPICS), encoding="ascii")
    for each in (build / "etc").iterdir():
        (folder / "etc" / each.name).symlink_to(each)
    return variables


def _read_record(folder: Path, sent_us: int) -> Record:
    try:
        tables, parameters = read_topics(next(folder.glob("log/**/*.ulg")), _TOPICS)
        stamps = [tables[name]["timestamp"][:, 0].astype(np.int64) for name in _TOPICS]
    except (StopIteration, KeyError, OSError, ValueError) as error:
        raise ConfigError(f"audit px4: PX4 has not logged what its simulator does: {error!r}") from None
    common = reduce(np.intersect1d, stamps)
    rows = [tables[name][np.searchsorted(stamp, common)] for name, stamp in zip(_TOPICS, stamps, strict=True)]
    outputs, motion, attitude, rates = rows
    return Record(
        common,
        outputs["output"][:, :ROTORS].astype(np.float64),
        -motion["z"][:, 0].astype(np.float64),
        np.hstack([motion[name] for name in ("vx", "vy", "vz")]).astype(np.float64),
        attitude["q"].astype(np.float64),
        rates["xyz"].astype(np.float64),
        parameters,
        sent_us,
    )
