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
IN_AIR, TAKEOFF = wire.MAV_LANDED_STATE_IN_AIR, wire.MAV_LANDED_STATE_TAKEOFF
REALS = {"MPC_THR_HOVER": 0.5, "MOT_THST_HOVER": 0.4, "GUID_TIMEOUT": 3.0}
SETPOINTS = {"SET_ATTITUDE_TARGET", "SET_ACTUATOR_CONTROL_TARGET"}


class Scripted:
    """Scripted autopilot with a fixed mode, its own parameters, and any stream of samples."""

    def __init__(self, link: socket.socket, *, kind: int = wire.MAV_AUTOPILOT_PX4, mode: int = HOLD, hz: int = 250,
                 grants: bool = True, faithful: bool = False, landed: int = 1) -> None:  # fmt: skip
        self.link, self.kind, self.mode, self.hz = link, kind, mode, hz
        self.landed, self.armed = landed, landed != 1
        self.grants, self.faithful = grants, faithful
        self.peer: tuple[str, int] | None = None
        self.heard: list = []
        self.packer = wire.MAVLink(None, 1, 1)
        self.sample_us = 1_000_000
        self._began, self._beat_at = time.monotonic(), 0.0
        self.is_stream = link.type == socket.SOCK_STREAM
        link.settimeout(0.002)

    def serve(self, ended: Callable[[], bool]) -> None:
        """Run until something has ended."""
        patience = time.monotonic() + PATIENCE_S
        while not ended():
            assert time.monotonic() < patience, f"heard only {set(self.names())}"
            self.listen()
            if self.peer is not None:
                self._speak(self.peer)

    def forget(self) -> None:
        """Discard all messages so far, read or unread."""
        with suppress(TimeoutError):
            while True:
                self.link.recv(2048)
        self.heard.clear()

    def hear_all(self) -> None:
        """Read what is still on its way from a peer that has ended."""
        while self.listen():
            pass

    def names(self) -> list[str]:
        return [message.get_type() for message in self.heard]

    def listen(self) -> bool:
        """Read and answer what has come; return whether anything has."""
        try:
            datagram, address = self.link.recvfrom(65_535)
        except (TimeoutError, ConnectionError):
            return False
        address = self.peer if self.is_stream else address
        # PX4 answers its first peer only, until it ends.
        self.peer = address if self.peer is None or not self.faithful else self.peer
        for message in (frame.message() for frame in parse(datagram)):
            self.heard.append(message)
            match message.get_type():
                case "PARAM_REQUEST_READ" if message.param_id in REALS:
                    name = message.param_id
                    self._say(wire.MAVLink_param_value_message(name.encode(), REALS[name], 9, 2, 0))
                case "PARAM_REQUEST_READ" if message.param_id == "GUID_OPTIONS":  # integers are cast there
                    self._say(wire.MAVLink_param_value_message(b"GUID_OPTIONS", 8.0, 6, 2, 0))
                case "PARAM_REQUEST_READ" if message.param_id == "IMU_INTEG_RATE":
                    bytewise = struct.unpack("<f", struct.pack("<i", 250))[0]
                    self._say(wire.MAVLink_param_value_message(b"IMU_INTEG_RATE", bytewise, 6, 2, 1))
                case "COMMAND_LONG" if message.command == wire.MAV_CMD_DO_SET_MODE:
                    self.mode = int(message.param2) << 16 | int(message.param3) << 24
                    self._say(wire.MAVLink_command_ack_message(message.command, wire.MAV_RESULT_ACCEPTED))
                case "COMMAND_LONG" if message.param1 == wire.MAVLINK_MSG_ID_HIGHRES_IMU:
                    self.hz = round(1e6 / message.param2) if self.grants else self.hz
                    result = wire.MAV_RESULT_ACCEPTED if self.grants else wire.MAV_RESULT_UNSUPPORTED
                    self._say(wire.MAVLink_command_ack_message(message.command, result))
        return bool(datagram)

    def _speak(self, peer: tuple[str, int]) -> None:
        if time.monotonic() > self._beat_at:
            self._beat_at = time.monotonic() + 0.2
            self._say(wire.MAVLink_heartbeat_message(2, self.kind, 1 + 128 * self.armed, self.mode, 3, 3))
            self._say(wire.MAVLink_extended_sys_state_message(0, self.landed))
            self._say(wire.MAVLink_attitude_message(0, 0.02, -0.01, 2.0, 0.0, 0.0, 0.0))
            self._say(wire.MAVLink_local_position_ned_message(0, 0.0, 0.0, -10.0, 0.0, 0.0, 0.0))
        interval_us = 1_000_000 // self.hz
        while self.sample_us + interval_us < 1_000_000 + (time.monotonic() - self._began) * 1e6:
            self.sample_us += interval_us
            at_rest = ImuSample(time_us=self.sample_us, gyro_B=(0.0, 0.0, 0.0), specific_force_B=(0.0, 0.0, -9.8))
            self._say(imu_message(at_rest))

    def _say(self, message) -> None:
        with suppress(ConnectionError):
            if self.is_stream:
                self.link.sendall(message.pack(self.packer))
            else:
                self.link.sendto(message.pack(self.packer), self.peer)


@contextmanager
def controller(port: int, *options: str) -> Iterator[subprocess.Popen[str]]:
    link = ["--connect", f"127.0.0.1:{port}"] if port else []
    command = [sys.executable, "-m", "gustproof.flight.endpoint", "--law", "hinf-rates", *link]
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


def test_ardupilot_in_guided_is_flown_in_the_air_and_sees_no_set_point_before(link):
    autopilot = Scripted(link, kind=wire.MAV_AUTOPILOT_ARDUPILOTMEGA, mode=GUIDED, landed=TAKEOFF, hz=50)
    with controller(link.getsockname()[1]) as running:
        until = []

        def has_waited() -> bool:
            if autopilot.hz == 250 and not until:
                until.append(time.monotonic() + 1.0)
            return bool(until) and time.monotonic() > until[0]

        autopilot.serve(has_waited)
        assert not SETPOINTS & set(autopilot.names())
        autopilot.landed = IN_AIR
        autopilot.serve(lambda: bool(SETPOINTS & set(autopilot.names())))
        running.send_signal(signal.SIGINT)
        _, err = running.communicate(timeout=PATIENCE_S)
    setpoint = next(message for message in autopilot.heard if message.get_type() in SETPOINTS)
    assert (setpoint.type_mask, setpoint.thrust) == (128, pytest.approx(0.4))
    assert "hinf-rates standing by: in control once GUIDED is set" in err
    assert "levels and holds its height after 3 s (GUID_TIMEOUT)" in err


def test_ardupilot_is_met_over_tcp_again_after_a_lost_connection():
    with closing(socket.socket()) as server:
        server.bind(("127.0.0.1", 0))
        server.listen()
        server.settimeout(PATIENCE_S)
        connect = f"tcp:127.0.0.1:{server.getsockname()[1]}"
        with controller(0, "--connect", connect) as running:
            server.accept()[0].close()
            with closing(server.accept()[0]) as link:
                autopilot = Scripted(link, kind=wire.MAV_AUTOPILOT_ARDUPILOTMEGA, mode=GUIDED, landed=IN_AIR)
                autopilot.peer = link.getpeername()
                autopilot.serve(lambda: bool(SETPOINTS & set(autopilot.names())))
                running.send_signal(signal.SIGINT)
                autopilot.serve(lambda: running.poll() is not None)
                autopilot.hear_all()
            _, err = running.communicate(timeout=PATIENCE_S)
    assert running.returncode == 130
    assert err.count("trying again") == 1
    last = [message for message in autopilot.heard if message.get_type() == "COMMAND_LONG"][-1]
    assert (last.command, last.param2) == (wire.MAV_CMD_DO_SET_MODE, 17.0)  # handed back in BRAKE


def test_udpin_meets_who_sends_an_autopilots_heartbeat(link):
    with closing(socket.socket(type=socket.SOCK_DGRAM)) as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    with controller(0, "--connect", f"udpin:127.0.0.1:{port}") as running:
        autopilot = Scripted(link, landed=IN_AIR)
        autopilot.peer = ("127.0.0.1", port)
        link.sendto(b"not MAVLink", autopilot.peer)
        autopilot.serve(lambda: bool(SETPOINTS & set(autopilot.names())))
        running.send_signal(signal.SIGINT)
        autopilot.serve(lambda: running.poll() is not None)
        autopilot.hear_all()
    assert running.returncode == 130
    assert autopilot.mode == HOLD  # taken in OFFBOARD, and handed back


def test_px4_at_50_hz_is_asked_for_the_rate_of_the_law(link):
    autopilot = Scripted(link, hz=50)
    with controller(link.getsockname()[1], "--json") as running:
        autopilot.serve(lambda: bool(SETPOINTS & set(autopilot.names())))
        running.send_signal(signal.SIGINT)
        assert end(running)["outcome"] == "interrupted"
    assert autopilot.hz == 250


def test_px4_that_declines_the_rate_is_refused_by_name(link):
    autopilot = Scripted(link, hz=50, grants=False)
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
    autopilot = Scripted(link, faithful=True)
    for _ in range(2):
        autopilot.forget()
        with controller(link.getsockname()[1], "--json") as running:
            autopilot.serve(lambda: bool(SETPOINTS & set(autopilot.names())))
            running.send_signal(signal.SIGINT)
            assert end(running)["outcome"] == "interrupted"
    assert autopilot.peer == ("127.0.0.1", remote)


def test_port_that_another_program_holds_is_told_and_another_one_is_used(px4_ports):
    link, remote = px4_ports
    autopilot = Scripted(link)
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
    assert "height: held by thrust, from LOCAL_POSITION_NED" in lines
    assert "hinf-rates standing by: in control once OFFBOARD is set" in lines
