"""PX4 in a process of its own: its build, its parameters for the vehicle file, its ports.

In lockstep two flights get the same bytes, and give the same ones back until PX4 arms. The thread that arms it does not
wait for the sample, so that it may come a sample later.
"""

import os
import re
import socket
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import all as wire

from firmware_model.config.firmware import LAW_GYRO_FILTER_HZ, px4_parameters
from firmware_model.config.parameter_files import read_parameters, write_parameters
from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.errors import ConfigError
from firmware_model.external.client import ExternalClient
from firmware_model.external.dialect import Dialect
from firmware_model.external.interface import (
    ExternalError,
    ExternalOptions,
    ExternalOutcome,
    candidate_places,
    check_law_inside,
    check_rate,
)
from firmware_model.external.px4 import SimulatorLink
from firmware_model.external.read_back import ParameterReader
from firmware_model.external.readings import Readings
from firmware_model.external.versions import absent_parameters, describe_no_law, read_version
from firmware_model.process.child import ChildProcess

_OFFBOARD = 6  # main mode
_EXTERNAL = 4.0, 11.0  # main mode AUTO, first mode that a module registers
_LAW_INSIDE = "gustproof"  # module of `gustproof export --px4`, and its array of set-points
_DIALECT = Dialect(wire.MAV_AUTOPILOT_PX4, "OFFBOARD", (_OFFBOARD, 0.0), _OFFBOARD << 16)
_INSIDE = Dialect(wire.MAV_AUTOPILOT_PX4, "the law's own mode", _EXTERNAL, 4 << 16 | 11 << 24, array_name=_LAW_INSIDE)
# The only one, without PX4's usual streams: each takes time from its samples, and from ours to read it.
_LINK = "mavlink start -x -u {port} -r 4000000 -f -m custom"
_MODEL = "none_iris"  # an airframe without a simulator of its own; all of its geometry is replaced
_SIMULATOR, _PILOT, _OTHERS = 4560, 14580, (18570, 14280, 13030)  # ports of instance 0
_INSTANCES = 200
_USUAL_PLACES = ("PX4-Autopilot", "~/PX4-Autopilot", "~/src/PX4-Autopilot")
_INSTALLED = ("px4", "px4-gazebo")  # programs of its packages for simulation
_SITL = Path("build/px4_sitl_default")
_CONNECT_TIMEOUT_S, _BOOT_TIMEOUT_S, _HUNG_S = 60.0, 60.0, 10.0
_BOOT_REPLY_S, _BOOT_POLL_S = 0.25, 0.02  # a sample without an answer by then has none: filters need the first ones
BOOTED = b"Startup script returned successfully"
"""Last words of its start script."""
_NO_LINK = "it started without a link to a simulator: it was built without simulator_mavlink"
_BOOT_WORDS = 2  # lines that tell why it did not start: the last one is the script's status alone
_RECEIVE = 4096  # bytes
_BANDWIDTH_HZ = 125.0  # of a sample
_GYRO_NOISE_LEAST = 0.001  # [rad/s] of a sample: PX4's counts

# Not of the vehicle: no sticks, no ground station, no log, no battery that runs down, and no timers of wall time.
_OPERATION = {
    "COM_RC_IN_MODE": "4",
    "NAV_RCL_ACT": "0",
    "NAV_DLL_ACT": "0",
    "COM_OF_LOSS_T": "10",
    "COM_DISARM_PRFLT": "-1",
    "COM_DISARM_LAND": "-1",
    "COM_LOW_BAT_ACT": "0",
    "CBRK_SUPPLY_CHK": "894281",
    "SDLOG_MODE": "-1",
    # One compass. The estimators of gyros stay three, as its start script has them: it sets their defaults after this,
    # and a value that is the default before is not kept.
    "EKF2_MULTI_MAG": "0",
    "SENS_MAG_MODE": "1",
    "EKF2_MAG_NOISE": "0.01",  # its least; our compass has a fiftieth
}
_PARAMETERS_FILE, _LINKS_FILE = "px4-rc.params", "px4-rc.mavlink"  # PX4's start script looks for these in its path
_SET, _OWN_LINKS = "param set {name} {value}", f". ${{R}}etc/init.d-posix/{_LINKS_FILE}"  # lines of its shell
_VARIABLE = "PX4_PARAM_"  # begins the variables that newer start scripts read in place of the file
_START_SCRIPT = "etc/init.d-posix/rcS"
_COMMENT = re.compile(r"(^|\s)#.*", re.MULTILINE)
_LAW = {"IMU_GYRO_CUTOFF": f"{LAW_GYRO_FILTER_HZ:g}"}
_AXES, _GAINS = ("ROLL", "PITCH", "YAW"), ("_P", "RATE_P", "RATE_I", "RATE_D")
_WATCHED = (*(f"MC_{axis}{gain}" for axis in _AXES for gain in _GAINS), "IMU_GYRO_CUTOFF", "IMU_DGYRO_CUTOFF")
"""Loops' parameters that are reported as the build has them: their defaults differ from version to version."""


def make_px4(options: ExternalOptions, scenario: Scenario, vehicle: Vehicle) -> "Px4":
    """Return PX4 for a flight, not started.

    Raises
    ------
    ConfigError
        If there is no build, or none with the law inside where one is to fly. If the parameter file is wrong, or PX4
        can't fly at the scenario's rate.
    """
    check_rate("px4", Px4.name, scenario)
    extra = read_parameters(options.params, "px4") if options.params else {}
    # By its default PX4 would trust the compass less than this gyro's drift, and its heading would wander by .1 deg.
    noise = {"EKF2_GYR_NOISE": f"{max(vehicle.gyro.noise_density * _BANDWIDTH_HZ**0.5, _GYRO_NOISE_LEAST):.4g}"}
    values = {**px4_parameters(vehicle), **_OPERATION, **noise, **(_LAW if options.law else {}), **extra}
    build = find_build(options.build)
    version = read_version("px4", build)
    if options.law:
        if not (build / "bin" / f"px4-{_LAW_INSIDE}").exists():
            lacks = describe_no_law("px4", version) or "build it with a folder of 'gustproof export --px4'"
            raise ConfigError(f"{build}: no law is built into it: {lacks}")
        check_law_inside(build / "bin" / "px4", options.law)
    px4 = Px4(build, options.folder, values, options.instance, real_time=options.real_time)
    px4.optional = absent_parameters("px4", version)
    px4.vital = px4_parameters(vehicle).keys() - set(px4.optional)
    if options.law:
        px4.dialect, px4.start_lines = _INSIDE, [f"{_LAW_INSIDE} start"]
    return px4


def find_build(given: Path | None) -> Path:
    """Return the build folder of a PX4 for simulation: given, in the environment, or at a usual place.

    Raises
    ------
    ConfigError
        If there is none.
    """
    places = candidate_places(given, "PX4_BUILD", _USUAL_PLACES, _INSTALLED)
    for place in places:
        for folder in (place, place / _SITL):
            if (folder / "bin" / "px4").is_file() and (folder / "etc").is_dir():
                return folder.resolve()
    looked = ", ".join(map(str, places))
    raise ConfigError(f"{looked}: no PX4 built for simulation (bin/px4 and etc): give --build, or set PX4_BUILD")


def reserve_instance(wanted: int | None = None) -> tuple[socket.socket, int]:
    """Take the first free instance, or the one that is wanted: no other flight can until the socket is closed.

    Raises
    ------
    ExternalError
        If there is none.
    """
    for instance in range(_INSTANCES) if wanted is None else [wanted]:
        server = _listen(_SIMULATOR + instance)
        if server is None:
            continue
        if all(_is_free(port + instance) for port in (_PILOT, *_OTHERS)):
            return server, instance
        server.close()
    which = f"of instance {wanted}" if wanted is not None else "of all instances, the first's"
    ports = f"TCP {_SIMULATOR + (wanted or 0)}, UDP {_PILOT + (wanted or 0)}"
    raise ExternalError(ExternalOutcome.PORT_TAKEN, f"another program uses the ports {which}: {ports}")


def onboard_port(instance: int) -> int:
    """Return the UDP port of an instance's on-board link."""
    return _PILOT + instance


def write_start_files(
    build: Path, folder: Path, parameters: Mapping[str, str], links: Sequence[str] | None
) -> dict[str, str]:
    """Write parameters for PX4's start script, and the lines that start its links in place of its own, if any.

    Return the variables of its environment that hold the parameters instead, for a build that reads these and no file.

    Raises
    ------
    ExternalError
        If the build has no start script, or one that takes no parameters.
    """
    path = build / _START_SCRIPT
    try:
        script = _COMMENT.sub("", path.read_text(encoding="utf-8", errors="replace"))
    except OSError as error:
        raise ExternalError(ExternalOutcome.WRONG_BUILD, f"{path}: {error.strerror}") from None
    variables = dict[str, str]()
    if _PARAMETERS_FILE in script:  # it comes last where a script reads both
        write_parameters(parameters, folder / _PARAMETERS_FILE, _SET)
    elif _VARIABLE in script:
        variables = {f"{_VARIABLE}{name}": value for name, value in parameters.items()}
        # 1.16 reads them before its script sets defaults of its own, and keeps none that was the default before.
        again = [_SET.format(name=name, value=value) for name, value in parameters.items()]
        links = [*again, *([_OWN_LINKS] if links is None else links)]
    else:
        takes = f"takes parameters neither from {_PARAMETERS_FILE} nor from variables {_VARIABLE}…"
        raise ExternalError(ExternalOutcome.WRONG_BUILD, f"{path}: {takes}")
    if links is not None:
        (folder / _LINKS_FILE).write_text("\n".join(links) + "\n", encoding="utf-8")
    return variables


def start_px4(
    build: Path, folder: Path, instance: int, model: str, variables: Mapping[str, str], speed: float | None = None
) -> ChildProcess:
    """Start PX4 in a folder, with `variables` in its environment that `write_start_files` has returned.

    `speed` is in multiples of real time, for a simulator of its own.

    Raises
    ------
    ExternalError
        If it is no program.
    """
    ours = {name: value for name, value in os.environ.items() if not name.startswith("PX4_")} | dict(variables)
    ours |= {"PX4_SIM_MODEL": model, "PATH": f"{folder.resolve()}:{ours.get('PATH', '')}", "HEADLESS": "1"}
    if speed is not None:
        ours["PX4_SIM_SPEED_FACTOR"] = f"{speed:g}"
    command = [str(build / "bin" / "px4"), "-i", str(instance), "-d", str(build / "etc")]
    try:
        return ChildProcess(command, folder, ours)
    except OSError as error:
        raise ExternalError(ExternalOutcome.WRONG_BUILD, f"{command[0]}: {error.strerror}") from None


class Px4:
    """PX4's process; see `ExternalProcess`. `start_lines` of its start script follow those of its links.

    Without a `vital` parameter it is another vehicle's; its version has none that is `optional`.
    """

    name = "PX4"
    warm_up_s = 20.0
    arming_timeout_s = 60.0
    arrival_s = 0.001  # unless the machine is busy

    def __init__(
        self, build: Path, folder: Path, parameters: Mapping[str, str], instance: int | None, *, real_time: bool
    ) -> None:
        self._build, self._folder, self._parameters = build, folder, dict(parameters)
        self._wanted, self._real_time = instance, real_time
        self._server: socket.socket | None = None
        self._peer: socket.socket | None = None
        self._process: ChildProcess | None = None
        self._link = SimulatorLink()
        self._booted = False
        self._begun_s = self._reply_s = 0.0
        self._replies = 0
        self._sent_s = 0.0
        self._time_us = 0
        self.instance = -1
        self.dialect, self.start_lines, self.vital = _DIALECT, list[str](), set[str]()
        self.optional: tuple[str, ...] = ()

    @property
    def system(self) -> int:
        """MAVLink system id."""
        return self.instance + 1

    @property
    def client_port(self) -> int | None:
        """UDP port of PX4's on-board link."""
        return onboard_port(self.instance)

    @property
    def is_armed(self) -> bool:
        """True if PX4's last answer came armed."""
        answer = self._link.answer
        return answer is not None and answer.is_armed

    def make_client(self) -> ExternalClient:
        """Return a client that speaks its dialect."""
        watched = [name for name in _WATCHED if name not in self._parameters]
        return ExternalClient(
            self.dialect, ParameterReader(self._parameters, vital=self.vital, optional=self.optional, watched=watched)
        )

    def start(self, client_port: int) -> None:
        """Start PX4 with its files in its folder, and accept its link to the simulator."""
        self._server, self.instance = reserve_instance(self._wanted)
        self._folder.mkdir(parents=True)
        lines = [_LINK.format(port=onboard_port(self.instance)), *self.start_lines]
        is_ours = bool(self.start_lines) or not self._real_time
        variables = write_start_files(self._build, self._folder, self._parameters, lines if is_ours else None)
        self._process = start_px4(self._build, self._folder, self.instance, _MODEL, variables)
        self._process.share_core()
        self._accept()

    def send(self, readings: Readings) -> None:
        """Send a sample."""
        frames = self._link.pack(readings)
        self._time_us, self._sent_s = readings.time_us, time.monotonic()
        try:
            self._connected.sendall(frames)
        except OSError:
            raise self._ending() from None

    def receive(self) -> tuple[float, ...] | None:
        """Return the rotor commands that answer the sample; `None` for one of the first, which have no answer."""
        link = self._link
        if not self._booted:
            self._wait_for_boot()
            return None
        while link.answer is None or link.answer.time_us < self._time_us:
            try:
                received = self._connected.recv(_RECEIVE)
            except TimeoutError:
                if link.answer is not None or time.monotonic() > self._begun_s + _BOOT_TIMEOUT_S:
                    raise self._hang() from None
                return None
            except OSError:
                raise self._ending() from None
            if not received:
                raise self._ending()
            link.feed(received)
        if not self._replies:
            self._connected.settimeout(_HUNG_S)
            if not link.answer.is_lockstep:
                raise ExternalError(ExternalOutcome.WRONG_BUILD, "it was built without lockstep")
        self._reply_s += time.monotonic() - self._sent_s
        self._replies += 1
        return link.answer.controls[:4]

    def close(self) -> None:
        """End PX4 and free its ports."""
        if self._process is not None:
            self._process.close()
        for each in (self._peer, self._server):
            if each is not None:
                each.close()

    def facts(self) -> Mapping[str, Any]:
        """Return build, instance, parameters and the mean time of an answer."""
        return {
            "build": str(self._build),
            "instance": self.instance,
            "folder": str(self._folder),
            "parameters": self._parameters,
            "reply_us": 1e6 * self._reply_s / self._replies if self._replies else 0.0,
        }

    @property
    def _connected(self) -> socket.socket:
        if self._peer is None:
            raise RuntimeError("PX4 is not started")
        return self._peer

    def _accept(self) -> None:
        """Wait for PX4's connection and its heartbeat."""
        server, until_s = self._server, time.monotonic() + _CONNECT_TIMEOUT_S
        if server is None:
            raise RuntimeError("PX4 has no instance")
        server.settimeout(0.1)
        while self._peer is None:
            has_started = self._process is not None and self._process.has_said(BOOTED)
            try:
                self._peer, _ = server.accept()
            except TimeoutError:
                if self._process is not None and self._process.ending:
                    raise self._ending(ExternalOutcome.WRONG_BUILD) from None
                if has_started:  # its script waits for the connection
                    raise ExternalError(ExternalOutcome.WRONG_BUILD, _NO_LINK) from None
                if time.monotonic() > until_s:
                    said = f"it did not connect to TCP port {_SIMULATOR + self.instance} in {_CONNECT_TIMEOUT_S:g} s"
                    raise ExternalError(ExternalOutcome.WRONG_BUILD, said) from None
        self._peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._peer.settimeout(_BOOT_REPLY_S)
        self._begun_s = time.monotonic()

    def _wait_for_boot(self) -> None:
        """Wait for the end of PX4's start script, after the first sample: so all modules start at one model time."""
        process, until_s = self._process, self._begun_s + _BOOT_TIMEOUT_S
        while process is None or not process.has_said(BOOTED):
            if process is None or process.ending:
                raise self._ending(ExternalOutcome.WRONG_BUILD)
            if time.monotonic() > until_s:
                said = f"not started after {_BOOT_TIMEOUT_S:g} s: {process.last_words}"
                raise ExternalError(ExternalOutcome.WRONG_BUILD, said)
            time.sleep(_BOOT_POLL_S)
        time.sleep(_BOOT_REPLY_S)
        self._booted = True

    def _hang(self) -> ExternalError:
        if self._process is not None and self._process.ending:
            return self._ending()
        return ExternalError(
            ExternalOutcome.HUNG, f"no answer to the sample at {self._time_us * 1e-6:g} s in {_HUNG_S:g} s"
        )

    def _ending(self, outcome: ExternalOutcome = ExternalOutcome.KILLED) -> ExternalError:
        lines = _BOOT_WORDS if outcome is ExternalOutcome.WRONG_BUILD else 1
        said = self._process.describe_ending("closed its link", lines) if self._process else "is not started"
        return ExternalError(outcome, f"PX4 {said}")


def _listen(port: int) -> socket.socket | None:
    server = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        server.bind(("127.0.0.1", port))
        server.listen(1)
    except OSError:
        server.close()
        return None
    return server


def _is_free(port: int) -> bool:
    """Return whether PX4, which binds all interfaces, can bind a UDP port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as tried:
        try:
            tried.bind(("0.0.0.0", port))
        except OSError:
            return False
    return True
