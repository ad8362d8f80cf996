"""Interface to an external autopilot (PX4, ArduPilot, Betaflight).

It runs in its own process and uses our simulation as its simulator.
"""

import os
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol

from firmware_model.config.scenario import Scenario
from firmware_model.errors import ConfigError
from firmware_model.external.dialect import Dialect

if TYPE_CHECKING:
    from firmware_model.external.client import ExternalClient
    from firmware_model.external.readings import Readings

SAMPLE_RATES_HZ = {"px4": 250, "ardupilot": 400, "betaflight": 250}
"""[Hz] Samples that each autopilot takes; one sample is one exchange with it, one pass of its rate loops."""

WITHOUT_LOCKSTEP = ("betaflight",)
"""Autopilots that run on the clock of the machine: flown at its pace, and no two flights are equal."""


class ExternalOutcome(Enum):
    """Outcome of an external autopilot's flight."""

    DONE = "done"
    """Flown from start to end under its own loops."""
    KILLED = "killed"
    """Its process ended."""
    HUNG = "hung"
    """It stopped answering."""
    WRONG_BUILD = "wrong_build"
    """No such autopilot is there, or it does not speak the protocol."""
    PORT_TAKEN = "port_taken"
    """Another program uses a port that it needs."""
    WRONG_GEOMETRY = "wrong_geometry"
    """Motor order, position or spin direction does not match the vehicle file."""
    WRONG_PARAMETERS = "wrong_parameters"
    """Read back before take-off, its parameters are not those that were set: they did not reach it."""
    NOT_ARMED = "not_armed"
    """It refused to arm, or to take set-points; the reason holds its own words."""
    UNSETTLED = "unsettled"
    """It did not hold the vehicle still in calm air, so that the scenario did not begin."""
    DISARMED = "disarmed"
    """It disarmed in flight."""
    LEFT_MODE = "left_mode"
    """It left the mode that follows set-points."""
    GPS_LOST = "gps_lost"
    """It left that mode, or disarmed, while the scenario kept the satellites from it."""
    INTERRUPTED = "interrupted"
    """Ctrl-C or a termination signal."""


class ExternalError(Exception):
    """End of a flight before its time; the text is one line."""

    def __init__(self, outcome: ExternalOutcome, reason: str) -> None:
        super().__init__(reason)
        self.outcome = outcome


@dataclass(slots=True, kw_only=True)
class ExternalOptions:
    """Options of a flight of a real autopilot, written by a parent process."""

    autopilot: Literal["px4", "ardupilot", "betaflight"]
    """Kind of autopilot."""
    build: Path | None = None
    """Folder of its build, `None` for the usual places."""
    params: Path | None = None
    """File of parameters or the name of a shipped set, on top of those that the vehicle file gives."""
    law: str = ""
    """Law inside of it, built into the autopilot."""
    instance: int | None = None
    """Number of the instance, from 0; `None` for a free one."""
    folder: Path
    """New folder that the autopilot runs in."""
    scenario: str
    """Script to fly, a name or a file."""
    vehicle: str
    """Name or file."""
    seed: int = 1
    """Seed of gusts and noise."""
    real_time: bool = False
    """True to fly at the pace of the clock."""
    journal: Path
    """New file for the records of the flight."""
    metadata: Path | None = None
    """JSON file with the metadata for the journal's header."""
    tlog: Path | None = None
    """New telemetry log of the client's link."""
    exit_on_stdin_eof: bool = False
    """True if a parent process holds the standard input open for as long as the flight shall last."""


class ExternalProcess(Protocol):
    """Process of an external autopilot: `start` it; for each sample `send` readings, `receive` commands; `close` it.

    Each method but `close` raises a `ExternalError` that names the outcome.
    """

    name: str
    """Name for users, such as PX4."""
    dialect: Dialect
    """Its words over MAVLink."""
    warm_up_s: float
    """[s] of its own time at rest until it is asked to arm: its estimator has settled by then."""
    arrival_s: float
    """[s] until a datagram on this machine has woken its reader; 0 if it reads its link in step with the samples."""
    arming_timeout_s: float
    """[s] of its own time from start until it has to be armed."""

    @property
    def system(self) -> int:
        """MAVLink system id."""

    @property
    def client_port(self) -> int | None:
        """UDP port on this machine for the client's first datagram; `None` if the autopilot speaks first."""

    @property
    def is_armed(self) -> bool:
        """True if its last answer came armed, or does not say."""

    def make_client(self) -> "ExternalClient":
        """Return the client that flies it."""

    def start(self, client_port: int) -> None:
        """Start its process; its client listens on the UDP port `client_port`."""

    def send(self, readings: "Readings") -> None:
        """Send the readings of a sample."""

    def receive(self) -> tuple[float, ...] | None:
        """Return each rotor's thrust, 0..1 of its largest, in the vehicle file's order; `None` if it has no answer."""

    def close(self) -> None:
        """End its process; never raises."""

    def facts(self) -> Mapping[str, Any]:
        """Return all that a record of the flight must say of it: build, parameters, ports."""


def candidate_places(given: Path | None, variable: str, usual: Sequence[str], programs: Sequence[str]) -> list[Path]:
    """Return where to look for a build: where it is given, else where a variable says, else at the usual places.

    The last of these are the folders of installed packages, whose `programs` are on the PATH.
    """
    if stated := given or os.environ.get(variable):
        return [Path(stated)]
    found = [Path(path).resolve().parent for path in map(shutil.which, programs) if path]
    installed = [folder.parent if folder.name == "bin" else folder for folder in found]
    return [*(Path(each).expanduser() for each in usual), *installed]


def check_law_inside(program: Path, wanted: str) -> None:
    """Refuse a build with another law inside than the one that is wanted, at whatever rate.

    An exported folder leaves its law's name in the program; a build of an older export does not tell.

    Raises
    ------
    ConfigError
        If the program tells of another law.
    """
    found = re.search(rb"Law '([\w.-]+)' in (?:place|control)", program.read_bytes())
    inside = found[1].decode() if found else wanted
    if wanted not in (inside, re.sub(r"-[\d_]+hz$", "", inside)):
        raise ConfigError(f"{program}: law '{inside}' is built into it, not '{wanted}'")


def check_rate(autopilot: str, name: str, scenario: Scenario) -> None:
    """Refuse a scenario at another rate than that of an autopilot, whose name for users is `name`.

    Raises
    ------
    ConfigError
        If its rate is another.
    """
    if scenario.control_rate_hz != (rate_hz := SAMPLE_RATES_HZ[autopilot]):
        has = f"has {scenario.control_rate_hz} samples a second"
        raise ConfigError(f"scenario '{scenario.name}' {has}, {name} takes {rate_hz}")


def scenario_for(autopilot: str, scenario: Scenario, rate_hz: int | None = None) -> Scenario:
    """Return a scenario at `rate_hz` or the simulation's rate of an autopilot, with steps no longer than before.

    The gusts are then those of the seed at that rate: they depend on the step, their statistics do not.
    """
    rate_hz = SAMPLE_RATES_HZ[autopilot] if rate_hz is None else rate_hz
    steps = -(-scenario.physics_rate_hz // rate_hz)
    if scenario.control_rate_hz == rate_hz:
        return scenario
    return replace(scenario, control_rate_hz=rate_hz, physics_rate_hz=steps * rate_hz)
