"""Three ground stations and a controller at once, in real time: each receives everything, and none counts a loss."""

import json
import select
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from itertools import pairwise

import pytest

from firmware_model.mavlink.frames import Frame, parse

pytestmark = pytest.mark.clients
HOST = "127.0.0.1"
IMU, SAMPLE_US = 105, 4_000


class Relay:
    """Carries datagrams between controller and vehicle, and notes what the vehicle sends and when."""

    def __init__(self, vehicle_port: int) -> None:
        self.sent: list[tuple[float, bytes]] = []
        self._front, self._back = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        for end in (self._front, self._back):  # datagrams must wait here while the machine is busy
            end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self._front.bind((HOST, 0))
        self._back.connect((HOST, vehicle_port))
        self._ended = threading.Event()
        self._carrier = threading.Thread(target=self._carry)

    @property
    def frames(self) -> list[tuple[float, Frame]]:
        """Time [s] and content of each frame of the autopilot."""
        found = [(at, frame) for at, datagram in list(self.sent) for frame in parse(datagram)]
        return [(at, frame) for at, frame in found if isinstance(frame, Frame) and frame.component == 1]

    @property
    def address(self) -> str:
        return f"{HOST}:{self._front.getsockname()[1]}"

    def __enter__(self) -> "Relay":
        self._carrier.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._carrier.join()
        self._front.close()
        self._back.close()

    def _carry(self) -> None:
        controller = None
        while not self._ended.is_set():
            readable, _, _ = select.select([self._front, self._back], [], [], 0.1)
            if self._front in readable:
                datagram, controller = self._front.recvfrom(65535)
                self._back.send(datagram)
            if self._back in readable:
                datagram = self._back.recv(65535)
                self._front.sendto(datagram, controller)
                self.sent.append((time.monotonic(), datagram))


def wait_until(seen: Callable[[], bool], patience_s: float = 60.0) -> None:
    deadline = time.monotonic() + patience_s
    while not seen():
        assert time.monotonic() < deadline
        time.sleep(0.05)


@contextmanager
def running(program: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, *program.split(), *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def test_ten_seconds_without_a_gap_and_each_sample_once(stand, programs):
    listen = str(programs / "mavutil_client.py")
    with ExitStack() as stack:
        vehicle = stack.enter_context(stand("--held", "--air", "paper-turbulence"))
        relay = stack.enter_context(Relay(vehicle.off_board_door))
        controller = stack.enter_context(
            running("-m gustproof.flight.endpoint", "--law", "hinf-d1", "--connect", relay.address, "--json")
        )
        wait_until(lambda: any(frame.message_id == IMU for _, frame in relay.frames))
        stations = [
            stack.enter_context(running(listen, "listen", address))
            for address in (
                f"udpin:{HOST}:{vehicle.ground_station}",
                f"udpin:{HOST}:{vehicle.off_board}",
                f"udpout:{HOST}:{vehicle.ground_station_door}",
            )
        ]
        heard = [station.communicate(timeout=120) for station in stations]
        controller.terminate()
        said = json.loads(controller.communicate(timeout=30)[0])
        last_words = vehicle.stop()

    assert [err for _, err in heard] == ["", "", ""]
    for out, _ in heard:
        facts = json.loads(out)
        assert facts["lost"] == 0
        assert facts["seconds"] >= 10.0
        assert facts["received"] > 10 * 300
    assert said["outcome"] == "interrupted"

    frames = relay.frames
    assert {(later.sequence - sooner.sequence) % 256 for (_, sooner), (_, later) in pairwise(frames)} == {1}
    samples = [(at, frame.message().time_usec) for at, frame in frames if frame.message_id == IMU]
    assert len(samples) > 10 * 250
    assert {later - sooner for (_, sooner), (_, later) in pairwise(samples)} == {SAMPLE_US}
    # 250 Hz on the wall clock too, apart from the slips that the vehicle itself reports on a busy machine. The relay
    # notes a datagram late or at once, never early: the least lateness of a second is that of the vehicle's clock.
    lateness = [at - time_us * 1e-6 for at, time_us in samples]
    drift_s, passed_s = min(lateness[-250:]) - min(lateness[:250]), samples[-1][0] - samples[0][0]
    assert drift_s == pytest.approx(0.0, abs=0.01 * passed_s + last_words["slipped_s"])
