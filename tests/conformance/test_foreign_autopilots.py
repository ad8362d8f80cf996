"""The controller's process against scripted autopilots that are not ours, over real sockets."""

import json
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.frames import parse
from firmware_model.mavlink.messages import imu_message
from firmware_model.types import ImuSample

PATIENCE_S = 60.0
HOLD, GUIDED = 4 << 16 | 3 << 24, 4
SETPOINTS = {"SET_ATTITUDE_TARGET", "SET_ACTUATOR_CONTROL_TARGET"}


class Foreign:
    """Scripted autopilot with a fixed mode, its own parameters, and any stream of samples."""

    def __init__(self, link: socket.socket, *, kind: int = wire.MAV_AUTOPILOT_PX4, mode: int = HOLD, hz: int = 250,
                 grants: bool = True, faithful: bool = False) -> None:  # fmt: skip
        self.link, self.kind, self.mode, self.hz = link, kind, mode, hz
        self.grants, self.faithful = grants, faithful
        self.peer: tuple[str, int] | None = None
        self.heard: list = []
        self.packer = wire.MAVLink(None, 1, 1)
        self.sample_us = 1_000_000
        self._began, self._beat_at = time.monotonic(), 0.0
        link.settimeout(0.002)

    def serve(self, ended: Callable[[], bool]) -> None:
        """Run until something has ended."""
        patience = time.monotonic() + PATIENCE_S
        while not ended():
            assert time.monotonic() < patience, f"heard only {set(self.names())}"
            self._listen()
            if self.peer is not None:
                self._speak(self.peer)

    def forget(self) -> None:
        """Discard all messages so far, read or unread."""
        with suppress(TimeoutError):
            while True:
                self.link.recv(2048)
        self.heard.clear()

    def names(self) -> list[str]:
        return [message.get_type() for message in self.heard]

    def _listen(self) -> None:
        try:
            datagram, address = self.link.recvfrom(2048)
        except (TimeoutError, ConnectionRefusedError):
            return
        # PX4 answers its first peer only, until it ends.
        self.peer = address if self.peer is None or not self.faithful else self.peer
        for message in (frame.message() for frame in parse(datagram)):
            self.heard.append(message)
            match message.get_type():
                case "PARAM_REQUEST_READ" if message.param_id == "MPC_THR_HOVER":
                    self._say(wire.MAVLink_param_value_message(b"MPC_THR_HOVER", 0.5, 9, 2, 0))
                case "PARAM_REQUEST_READ" if message.param_id == "IMU_INTEG_RATE":
                    bytewise = struct.unpack("<f", struct.pack("<i", 250))[0]
                    self._say(wire.MAVLink_param_value_message(b"IMU_INTEG_RATE", bytewise, 6, 2, 1))
                case "COMMAND_LONG" if message.command == wire.MAV_CMD_SET_MESSAGE_INTERVAL:
                    self.hz = round(1e6 / message.param2) if self.grants else self.hz
                    result = wire.MAV_RESULT_ACCEPTED if self.grants else wire.MAV_RESULT_UNSUPPORTED
                    self._say(wire.MAVLink_command_ack_message(message.command, result))

    def _speak(self, peer: tuple[str, int]) -> None:
        if time.monotonic() > self._beat_at:
            self._beat_at = time.monotonic() + 0.2
            self._say(wire.MAVLink_heartbeat_message(2, self.kind, 1, self.mode, 3, 3))
        interval_us = 1_000_000 // self.hz
        while self.sample_us + interval_us < 1_000_000 + (time.monotonic() - self._began) * 1e6:
            self.sample_us += interval_us
            at_rest = ImuSample(time_us=self.sample_us, gyro_B=(0.0, 0.0, 0.0), specific_force_B=(0.0, 0.0, -9.8))
            self._say(imu_message(at_rest))

    def _say(self, message) -> None:
        self.link.sendto(message.pack(self.packer), self.peer)


@contextmanager
def controller(port: int, *options: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "gustproof.controller", "--law", "hinf-rates", "--connect", f"127.0.0.1:{port}"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([*command, *options], **pipes, text=True) as running:
        try:
            yield running
        finally:
            running.kill()


@pytest.fixture
def link() -> Iterator[socket.socket]:
    with closing(socket.socket(type=socket.SOCK_DGRAM)) as bound:
        bound.bind(("127.0.0.1", 0))
        yield bound


@pytest.fixture
def px4_ports() -> Iterator[tuple[socket.socket, int]]:
    """Yield a socket on a port of PX4's simulation, and the port that it sends to first."""
    for instance in range(10):
        with (
            closing(socket.socket(type=socket.SOCK_DGRAM)) as bound,
            closing(socket.socket(type=socket.SOCK_DGRAM)) as near,
        ):
            try:
                bound.bind(("127.0.0.1", 14580 + instance))
                near.bind(("127.0.0.1", 14540 + instance))
            except OSError:
                continue
            near.close()
            yield bound, 14540 + instance
            return
    pytest.skip("no port of PX4's simulation is free")


def end(running: subprocess.Popen[str]) -> dict:
    out, err = running.communicate(timeout=PATIENCE_S)
    assert err == ""
    return json.loads(out.splitlines()[-1])


def test_ardupilot_in_guided_is_refused_by_name_and_sees_no_set_point(link):
    autopilot = Foreign(link, kind=wire.MAV_AUTOPILOT_ARDUPILOTMEGA, mode=GUIDED)
    with controller(link.getsockname()[1], "--json") as running:
        autopilot.serve(lambda: running.poll() is not None)
        told = end(running)
    assert (running.returncode, told["outcome"]) == (2, "not_supported")
    assert told["message"].startswith("ArduPilot is not supported yet")
    assert set(autopilot.names()) == {"HEARTBEAT"}


def test_px4_at_50_hz_is_asked_for_the_rate_of_the_law(link):
    autopilot = Foreign(link, hz=50)
    with controller(link.getsockname()[1], "--json") as running:
        autopilot.serve(lambda: bool(SETPOINTS & set(autopilot.names())))
        running.send_signal(signal.SIGINT)
        assert end(running)["outcome"] == "interrupted"
    assert autopilot.hz == 250


def test_px4_that_declines_the_rate_is_refused_by_name(link):
    autopilot = Foreign(link, hz=50, grants=False)
    with controller(link.getsockname()[1], "--json") as running:
        autopilot.serve(lambda: running.poll() is not None)
        told = end(running)
    asked = next(message for message in autopilot.heard if message.get_type() == "COMMAND_LONG")
    assert (asked.command, asked.param1, asked.param2) == (511, 105.0, 4000.0)
    assert (running.returncode, told["outcome"]) == (2, "wrong_rate")
    assert told["message"].startswith("HIGHRES_IMU arrives at 50 Hz, law 'hinf-rates' needs 250 Hz")
    assert not SETPOINTS & set(autopilot.names())


def test_px4_that_answers_its_first_peer_alone_is_met_at_the_second_start(px4_ports):
    link, remote = px4_ports
    autopilot = Foreign(link, faithful=True)
    for _ in range(2):
        autopilot.forget()
        with controller(link.getsockname()[1], "--json") as running:
            autopilot.serve(lambda: bool(SETPOINTS & set(autopilot.names())))
            running.send_signal(signal.SIGINT)
            assert end(running)["outcome"] == "interrupted"
    assert autopilot.peer == ("127.0.0.1", remote)


def test_port_that_another_program_holds_is_told_and_another_one_is_used(px4_ports):
    link, remote = px4_ports
    autopilot = Foreign(link)
    with closing(socket.socket(type=socket.SOCK_DGRAM)) as holder:
        holder.bind(("127.0.0.1", remote))
        with controller(link.getsockname()[1]) as running:
            autopilot.serve(lambda: bool(SETPOINTS & set(autopilot.names())))
            running.send_signal(signal.SIGINT)
            _, err = running.communicate(timeout=PATIENCE_S)
    lines = [line.removeprefix("gustproof controller: ") for line in err.splitlines()]
    assert lines[0].startswith(f"can't listen on UDP port {remote}: Address already in use; a free port is used")
    assert lines[1:3] == [
        f"waiting for an autopilot at 127.0.0.1:{link.getsockname()[1]}",
        "found PX4, system 1: reading MPC_THR_HOVER, IMU_INTEG_RATE, requesting HIGHRES_IMU at 250 Hz",
    ]
    assert lines[3] == "hinf-rates standing by: in control once OFFBOARD is set"
