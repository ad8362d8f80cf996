"""ArduCopter in a process of its own: its build, its parameters for the vehicle file, its sockets.

All ports are free ones of this flight alone, so flights side by side do not meet.
"""

import os
import socket
import struct
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import all as wire

from firmware_model.config.firmware import LAW_GYRO_FILTER_HZ, ardupilot_hover
from firmware_model.config.parameter_files import read_parameters, write_parameters
from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.errors import ConfigError
from firmware_model.external.ardupilot import FrameKind, FrameReader, encode_answer, map_outputs
from firmware_model.external.client import ExternalClient
from firmware_model.external.dialect import Dialect
from firmware_model.external.interface import (
    SAMPLE_RATES_HZ,
    ExternalError,
    ExternalOptions,
    ExternalOutcome,
    candidate_places,
    check_law_inside,
    check_rate,
)
from firmware_model.external.read_back import ParameterReader
from firmware_model.external.readings import Readings
from firmware_model.external.versions import describe_no_law, find_row, read_version
from firmware_model.mavlink.services.geodesy import ORIGIN_DEG
from firmware_model.process import udp
from firmware_model.process.child import ChildProcess

_RATE_HZ = SAMPLE_RATES_HZ["ardupilot"]  # that of its loop by default
_GUIDED = 4
_USUAL_PLACES = ("ardupilot", "~/ardupilot", "~/src/ardupilot")
_PROGRAMS = ("", "arducopter", "bin/arducopter", "sitl/bin/arducopter", "build/sitl/bin/arducopter")
_PARAMETERS_FILE = "vehicle.parm"
_START_S = 1_700_000_000  # its Unix time at start: the same in each flight
_SPEEDUP = 1000  # times real time at most; it never gets there
_FRAME = 128  # [bytes] above the largest
_START_TIMEOUT_S, _HUNG_S, _WAIT_S = 30.0, 10.0, 0.5
# A frame that repeats sooner crossed its answer: a second one would stay one ahead for ever.
_LOST_S = 0.5

_CHECK_OF_INERTIAL_SENSORS = 16
# Offsets of 0 count as not calibrated, other ones as those of a second accelerometer.
_CALIBRATION = {"OFFS": "0.001", "SCAL": "1", "2OFFS": "0", "2SCAL": "1"}
# Not of the vehicle. One sensor of each kind, as there is one; no battery, sticks or log, and no timers on the ground.
_OPERATION = {
    "FRAME_CLASS": "1",
    "FRAME_TYPE": "1",  # X; its default is plus, with torques turned by 45 deg
    "SCHED_LOOP_RATE": str(_RATE_HZ),
    "SIM_RATE_HZ": str(_RATE_HZ),
    "SIM_DRIFT_SPEED": "0",  # no gyro drift but the scenario's; .04 deg/s of noise of its own stays
    "INS_ENABLE_MASK": "1",
    **{f"INS_ACC{name}_{axis}": value for name, value in _CALIBRATION.items() for axis in "XYZ"},
    "EK3_IMU_MASK": "1",
    "COMPASS_USE2": "0",
    "COMPASS_USE3": "0",
    "SIM_MAG2_DEVID": "0",
    "SIM_MAG3_DEVID": "0",
    "SIM_MAG1_OFS_X": "5",  # a compass without offsets counts as not calibrated
    "SIM_MAG1_OFS_Y": "5",
    "SIM_MAG1_OFS_Z": "5",
    "COMPASS_OFS_X": "5",
    "COMPASS_OFS_Y": "5",
    "COMPASS_OFS_Z": "5",
    # Its compass here has no noise; this is its least. It fuses three axes after a climb: never on the stand.
    "EK3_MAG_M_NSE": "0.01",
    "EK3_MAG_CAL": "4",
    "MOT_PWM_MIN": "1000",
    "MOT_PWM_MAX": "2000",
    "MOT_BAT_VOLT_MAX": "0",
    "MOT_SPIN_ARM": "0.1",
    "MOT_SPIN_MIN": "0.15",
    "MOT_SPIN_MAX": "0.95",
    "MOT_HOVER_LEARN": "0",
    "GUID_OPTIONS": "8",  # the thrust of a set-point is thrust, not rate of climb
    # It asks for two samples of the gyro in each pass of its loop. A version has one of these, see `VERSIONS`.
    "ARMING_CHECK": str((1 << 21) - 2 - _CHECK_OF_INERTIAL_SENSORS),
    "ARMING_SKIPCHK": str(_CHECK_OF_INERTIAL_SENSORS),
    "DISARM_DELAY": "0",
    "FS_THR_ENABLE": "0",
    "LOG_BACKEND_TYPE": "0",
}
_VITAL = ("FRAME_CLASS", "FRAME_TYPE", "MOT_THST_EXPO", "MOT_THST_HOVER", "MOT_SPIN_MIN", "MOT_SPIN_MAX", "SIM_RATE_HZ")
"""Read back from it in each flight: without these it flies another vehicle."""
_AXES, _GAINS = ("RLL", "PIT", "YAW"), ("P", "I", "D", "FLTD")
_WATCHED = (
    *(f"ATC_ANG_{axis}_P" for axis in _AXES),
    *(f"ATC_RAT_{axis}_{gain}" for axis in _AXES for gain in _GAINS),
    "INS_GYRO_FILTER",
)
"""Loops' parameters that are reported as the build has them: their defaults differ from version to version."""
# A law inside is a custom controller: the third, after ArduPilot's empty one and its PID, for all axes.
_LAW = {"CC_TYPE": "3", "CC_AXIS_MASK": "7", "INS_GYRO_FILTER": f"{LAW_GYRO_FILTER_HZ:g}"}
_FIX_SWITCHES = (("SIM_GPS1_ENABLE", 1.0, 0.0), ("SIM_GPS_DISABLE", 0.0, 1.0))  # from 4.6 on, and before
_LAW_SWITCH, _LAW_IS_ON = (float(wire.MAV_CMD_DO_AUX_FUNCTION), 109.0, 2.0), "Custom controller is ON"


def make_ardupilot(options: ExternalOptions, scenario: Scenario, vehicle: Vehicle) -> "ArduPilot":
    """Return ArduPilot for a flight, not started.

    Raises
    ------
    ConfigError
        If there is no build, or one with another law inside than the one that is to fly. If the parameter file is
        wrong, the vehicle has no frame of ArduPilot, or the scenario has another rate.
    """
    check_rate("ardupilot", ArduPilot.name, scenario)
    extra = read_parameters(options.params, "ardupilot") if options.params else {}
    values = {"MOT_THST_EXPO": "0", **_OPERATION, **(_LAW if options.law else {}), **extra}
    values = {"MOT_THST_HOVER": ardupilot_hover(vehicle, thrust_range(values)), **values}
    program = find_build(options.build)
    version = read_version("ardupilot", program)
    if read := find_row("ardupilot", version):
        values = {name: value for name, value in values.items() if name in extra or name not in read.absent}
    if options.law and (lacks := describe_no_law("ardupilot", version)):
        raise ConfigError(f"{program}: no law is built into it: {lacks}")
    external = ArduPilot(program, options.folder, values, map_outputs(vehicle))
    external.compared |= extra.keys() | (_LAW.keys() if options.law else set())
    if options.law:
        check_law_inside(program, options.law)
        external.dialect = external.dialect._replace(law_switch=_LAW_SWITCH, law_is_on=_LAW_IS_ON)
    return external


def find_build(given: Path | None) -> Path:
    """Return the program of an ArduCopter for simulation: given, in the environment, or at a usual place.

    A place is the program, the folder that it is in, or that of the sources.

    Raises
    ------
    ConfigError
        If there is none.
    """
    places = candidate_places(given, "ARDUPILOT_BUILD", _USUAL_PLACES, ("arducopter",))
    for place in places:
        for program in _PROGRAMS:
            if (path := place / program).is_file() and os.access(path, os.X_OK):
                return path.resolve()
    looked = ", ".join(map(str, places))
    raise ConfigError(
        f"{looked}: no ArduCopter built for simulation (build/sitl/bin/arducopter): give --build, or set "
        "ARDUPILOT_BUILD"
    )


def place_and_links(client_port: int) -> list[str]:
    """Return the options for its home, and for one link alone: to the UDP port of its client.

    Home is at sea level: above it the commands would grow with thinner air, which the rotors here do not feel.
    """
    latitude, longitude = ORIGIN_DEG
    links = {"--serial0": f"udpclient:127.0.0.1:{client_port}", "--rc-in-port": "0"}
    links |= {f"--serial{i}": f"none:{i}" for i in (1, 2, 4)}
    return ["--home", f"{latitude},{longitude},0,0", *(word for pair in links.items() for word in pair)]


def thrust_range(parameters: Mapping[str, str]) -> tuple[float, float]:
    """Return the thrust at throttle 0 and 1, as a fraction of the largest.

    Raises
    ------
    ConfigError
        If there is no room between them.
    """
    low, high = (float(parameters[name]) for name in ("MOT_SPIN_MIN", "MOT_SPIN_MAX"))
    if not 0.0 <= low < high <= 1.0:
        raise ConfigError(f"MOT_SPIN_MIN {low:g} must be from 0 to below MOT_SPIN_MAX, {high:g}, which is at most 1")
    return low, high


class ArduPilot:
    """ArduPilot's process; see `ExternalProcess`. `outputs` holds the number of each rotor's output, from 0.

    `compared` are the names of parameters that are read back before take-off.
    """

    name = "ArduPilot"
    arming_timeout_s = 120.0
    warm_up_s = 0.0  # its own checks ask for a settled estimator
    arrival_s = 0.0  # it reads its link in its loop
    system = 1
    client_port = None
    is_armed = True

    def __init__(self, program: Path, folder: Path, parameters: Mapping[str, str], outputs: tuple[int, ...]) -> None:
        self._program, self._folder, self._parameters = program, folder, dict(parameters)
        self.dialect = Dialect(
            wire.MAV_AUTOPILOT_ARDUPILOTMEGA,
            "GUIDED",
            (_GUIDED, 0.0),
            _GUIDED,
            thrust_range=thrust_range(parameters),
            fix_switches=_FIX_SWITCHES,
        )
        self.compared: frozenset[str] = frozenset(_VITAL)
        self._reader = FrameReader(outputs)
        self._bound: socket.socket | None = None
        self._process: ChildProcess | None = None
        self._answer = b""
        self._sent_s = self._received_s = self._reply_s = 0.0
        self._replies = 0

    def make_client(self) -> ExternalClient:
        """Return a client that speaks its dialect."""
        values = {name: value for name, value in self._parameters.items() if name in self.compared}
        watched = [name for name in _WATCHED if name not in values]
        return ExternalClient(self.dialect, ParameterReader(values, vital=_VITAL, watched=watched, bytewise=False))

    def start(self, client_port: int) -> None:
        """Start ArduPilot in its folder, and wait for its first frame."""
        self._bound = bound = udp.bind(0)
        bound.setblocking(True)
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("@ll", 0, round(1e6 * _WAIT_S)))
        self._folder.mkdir(parents=True)
        write_parameters(self._parameters, self._folder / _PARAMETERS_FILE, "{name} {value}")
        command = [
            str(self._program),
            "--model",
            "JSON:127.0.0.1",
            "--sim-port-out",
            str(bound.getsockname()[1]),
            "--speedup",
            str(_SPEEDUP),
            "--start-time",
            str(_START_S),
            "--defaults",
            _PARAMETERS_FILE,
            *place_and_links(client_port),
        ]
        try:
            self._process = ChildProcess(command, self._folder, os.environ)
        except OSError as error:
            raise ExternalError(ExternalOutcome.WRONG_BUILD, f"{command[0]}: {error.strerror}") from None
        self._process.share_core()
        self._accept()

    def send(self, readings: Readings) -> None:
        """Send a sample."""
        self._answer, self._sent_s = encode_answer(readings), time.monotonic()
        if self._sent_s - self._received_s > _LOST_S:
            self._forget_repeats()
        self._send()

    def receive(self) -> tuple[float, ...]:
        """Return the rotor commands that answer the sample."""
        waits = 0
        while True:
            try:
                datagram = self._connected.recv(_FRAME)
            except BlockingIOError:
                waits += 1
                self._check_alive()
                if waits * _WAIT_S >= _HUNG_S:
                    raise ExternalError(ExternalOutcome.HUNG, f"no frame in {_HUNG_S:g} s") from None
                continue
            except OSError:
                raise self._ending() from None
            frame = self._reader.read(datagram)
            if frame.kind is FrameKind.NEW:
                self._received_s = time.monotonic()
                self._reply_s += self._received_s - self._sent_s
                self._replies += 1
                return frame.rotors
            if frame.kind is FrameKind.RESTARTED:
                raise ExternalError(ExternalOutcome.KILLED, "ArduPilot started anew: its count of frames went back")
            if frame.kind is FrameKind.REPEATED and time.monotonic() - self._sent_s > _LOST_S:
                self._send()

    def close(self) -> None:
        """End ArduPilot and free its ports."""
        if self._process is not None:
            self._process.close()
        if self._bound is not None:
            self._bound.close()

    def facts(self) -> Mapping[str, Any]:
        """Return build, parameters and the mean time of an answer."""
        return {
            "build": str(self._program),
            "folder": str(self._folder),
            "parameters": self._parameters,
            "reply_us": 1e6 * self._reply_s / self._replies if self._replies else 0.0,
        }

    @property
    def _connected(self) -> socket.socket:
        if self._bound is None:
            raise RuntimeError("ArduPilot is not started")
        return self._bound

    def _accept(self) -> None:
        """Wait for the first frame, and take its sender for the only one."""
        until_s = time.monotonic() + _START_TIMEOUT_S
        while time.monotonic() < until_s:
            try:
                datagram, address = self._connected.recvfrom(_FRAME)
            except BlockingIOError:
                self._check_alive(ExternalOutcome.WRONG_BUILD)
                continue
            if self._reader.read(datagram).kind is FrameKind.NEW:
                udp.connect(self._connected, address)
                return
        raise ExternalError(ExternalOutcome.WRONG_BUILD, f"no frame of the JSON interface in {_START_TIMEOUT_S:g} s")

    def _forget_repeats(self) -> None:
        """Drop what was asked while the answer was late: it asks for the one that is about to be sent."""
        with suppress(OSError):
            while True:
                self._connected.recv(_FRAME, socket.MSG_DONTWAIT)

    def _send(self) -> None:
        try:
            self._connected.send(self._answer)
        except OSError:
            raise self._ending() from None

    def _check_alive(self, outcome: ExternalOutcome = ExternalOutcome.KILLED) -> None:
        if self._process is None or self._process.ending:
            raise self._ending(outcome)

    def _ending(self, outcome: ExternalOutcome = ExternalOutcome.KILLED) -> ExternalError:
        said = self._process.describe_ending("closed its port") if self._process else "is not started"
        return ExternalError(outcome, f"ArduPilot {said}")
