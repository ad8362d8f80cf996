"""ArduCopter as a guest: its build, its parameters, its process and the socket of its JSON interface.

Every port is free and of this flight alone, so flights side by side do not meet. The first frame tells that it is up.
"""

import os
import socket
import struct
import time
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import all as wire

from firmware_model.config.files import read_text
from firmware_model.config.vehicle import GRAVITY, Vehicle
from firmware_model.errors import ConfigError
from firmware_model.guest.ardupilot_json import FrameKind, FrameReader, encode_answer, map_outputs
from firmware_model.guest.child import ChildProcess
from firmware_model.guest.guest import Dialect, GuestError, GuestOutcome
from firmware_model.guest.readings import Readings
from firmware_model.mavlink.services.geodesy import ORIGIN_DEG
from firmware_model.process import udp

SAMPLE_RATE_HZ = 400
"""[Hz] Samples of a scenario that ArduPilot flies: one for each pass of its loop, at its default rate."""
ENVIRONMENT = "GUSTPROOF_ARDUPILOT"
"""Environment variable with the build, for users and tests."""
_DATA = files("firmware_model.guest") / "data" / "ardupilot"
_PLACES = ("", "arducopter", "bin/arducopter", "sitl/bin/arducopter", "build/sitl/bin/arducopter")
_SPIN = (0.15, 0.95)  # MOT_SPIN_MIN, MOT_SPIN_MAX of base.param
# Above the sea ArduPilot raises its commands by the density of the air, which the rotors here do not feel.
_HOME = "{0},{1},0,0".format(*ORIGIN_DEG)
_START_TIME = 1_700_000_000  # [s] its Unix time at start: two flights get the same
_SPEEDUP = 1000  # times real time at most, far above what it reaches
_FRAME_SIZE = 128  # bytes, above the largest
_START_TIMEOUT_S, _ANSWER_TIMEOUT_S, _WAIT_S = 30.0, 10.0, 0.5


class ArduPilot:
    """ArduCopter as a guest; `parameters` go on top of those of world and vehicle."""

    name = "ArduPilot"
    dialect = Dialect(wire.MAV_AUTOPILOT_ARDUPILOTMEGA, "GUIDED", (4.0, 0.0), 4)
    arming_timeout_s = 120.0
    system = 1
    pilot_port = None
    is_armed = True

    def __init__(self, vehicle: Vehicle, build: Path, folder: Path, parameters: Mapping[str, float]) -> None:
        self._reader = FrameReader(map_outputs(vehicle))
        self._binary = find_build(build)
        self._folder = folder
        self._parameters = {**base_parameters(vehicle), **parameters}
        self._socket: socket.socket | None = None
        self._child: ChildProcess | None = None
        self._answer = b""

    def start(self, pilot_port: int) -> None:
        """Start its process, and wait for its first frame.

        Raises
        ------
        GuestError
            If it does not start, or sends no frame.
        """
        self._socket = udp.bind(0)
        port = self._socket.getsockname()[1]
        self._socket.setblocking(True)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("@ll", 0, round(1e6 * _WAIT_S)))
        parameters = self._folder / "parameters.param"
        parameters.write_text(format_parameters(self._parameters))
        command = [
            str(self._binary), "--model", "JSON:127.0.0.1", "--sim-port-out", str(port), "--speedup", str(_SPEEDUP),
            "--home", _HOME, "--start-time", str(_START_TIME), "--defaults", parameters.name,
            "--serial0", f"udpclient:127.0.0.1:{pilot_port}", "--serial1", "none:1", "--serial2", "none:2",
            "--serial4", "none:4", "--rc-in-port", "0",
        ]  # fmt: skip
        try:
            self._child = ChildProcess(command, self._folder, {})
        except OSError as error:
            raise GuestError(GuestOutcome.WRONG_BUILD, f"can't start {self._binary}: {error.strerror}") from None
        until = time.monotonic() + _START_TIMEOUT_S
        while time.monotonic() < until:
            if self._child.ending:
                said = f"{self._binary.name} {self._child.ending}: {self._child.last_words}"
                raise GuestError(GuestOutcome.WRONG_BUILD, said)
            try:
                datagram, address = self._socket.recvfrom(_FRAME_SIZE)
            except BlockingIOError:
                continue
            if self._reader.read(datagram).kind is FrameKind.NEW:
                udp.connect(self._socket, address)
                return
        raise GuestError(GuestOutcome.WRONG_BUILD, f"{self._binary.name} sends no frames of the JSON interface")

    def send(self, readings: Readings) -> None:
        """Send the readings of a sample."""
        self._answer = encode_answer(readings)
        self._send()

    def receive(self) -> tuple[float, ...]:
        """Return each rotor's thrust, 0..1 of its largest, in the vehicle file's order.

        Raises
        ------
        GuestError
            If it has ended, hangs or started anew.
        """
        assert self._socket is not None
        waits = 0
        while True:
            try:
                datagram = self._socket.recv(_FRAME_SIZE)
            except BlockingIOError:
                waits += 1
                self._check_alive(waits * _WAIT_S)
                continue
            except ConnectionRefusedError:
                self._check_alive(0.0)
                continue
            frame = self._reader.read(datagram)
            if frame.kind is FrameKind.NEW:
                return frame.rotors
            if frame.kind is FrameKind.REPEATED:
                self._send()
            elif frame.kind is FrameKind.RESTARTED:
                raise GuestError(GuestOutcome.KILLED, "it started anew: its count of frames went back")

    def close(self) -> None:
        """End its process; never raises."""
        if self._child is not None:
            self._child.close()
        if self._socket is not None:
            self._socket.close()

    def facts(self) -> dict[str, Any]:
        """Return build and parameters."""
        return {"build": str(self._binary), "parameters": self._parameters, "home": _HOME}

    def _send(self) -> None:
        assert self._socket is not None
        try:
            self._socket.send(self._answer)
        except ConnectionRefusedError:
            self._check_alive(0.0)

    def _check_alive(self, silence_s: float) -> None:
        assert self._child is not None
        if ending := self._child.ending:
            raise GuestError(GuestOutcome.KILLED, f"{ending}: {self._child.last_words}")
        if silence_s >= _ANSWER_TIMEOUT_S:
            raise GuestError(GuestOutcome.HUNG, f"no frame for {silence_s:g} s")


def find_build(build: Path) -> Path:
    """Return the program of a build: given itself, or the folder that it is in, or that of the tree.

    Raises
    ------
    ConfigError
        If there is none.
    """
    for place in _PLACES:
        if (path := build / place).is_file() and os.access(path, os.X_OK):
            return path.resolve()
    raise ConfigError(f"{build}: no program 'arducopter' there, nor in build/sitl/bin")


def base_parameters(vehicle: Vehicle) -> dict[str, float]:
    """Return the parameters that our world and the vehicle's rotors need."""
    hover = vehicle.mass * GRAVITY / (4.0 * vehicle.rotors.thrust_max)
    low, high = _SPIN
    return {**load_parameters("base"), "MOT_THST_HOVER": round((hover - low) / (high - low), 4)}


def list_parameter_sets() -> tuple[str, ...]:
    """Return the names of the shipped parameter sets."""
    return ("stock", "tuned")


def load_parameters(name_or_path: str | Path) -> dict[str, float]:
    """Return the parameters of a file, or of a shipped set by its name: lines of name and value.

    Raises
    ------
    ConfigError
        If there is no such file, or a line has no name and value.
    """
    shipped = _DATA / f"{name_or_path}.param"
    text = shipped.read_text() if shipped.is_file() else read_text(Path(name_or_path))
    found: dict[str, float] = {}
    for number, line in enumerate(text.splitlines(), 1):
        words = line.partition("#")[0].replace(",", " ").replace("=", " ").split()
        if not words:
            continue
        try:
            name, value = words[:2]
            found[name.upper()] = float(value)
        except ValueError:
            raise ConfigError(f"{name_or_path}: line {number}: '{line.strip()}' is no parameter's name and value") from None
    return found


def format_parameters(parameters: Mapping[str, float]) -> str:
    """Return parameters as ArduPilot reads them."""
    return "".join(f"{name} {value:.9g}\n" for name, value in parameters.items())
