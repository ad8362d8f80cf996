"""A vehicle on the ground for other people's programs, each in a process of its own."""

import json
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

HOST = "127.0.0.1"
PROGRAMS = Path(__file__).with_name("programs")
PORTS = (
    18570,
    14580,
    14550,
    14540,
)  # the vehicle's own two, then where it looks for a ground station and an off-board API


@dataclass(frozen=True)
class Vehicle:
    """A running vehicle and where its clients meet it."""

    process: subprocess.Popen[str]
    instance: int

    @property
    def system(self) -> int:
        return self.instance + 1

    @property
    def ground_station(self) -> int:
        """Port at which a ground station waits for the vehicle."""
        return 14550 + self.instance

    @property
    def off_board(self) -> int:
        """Port at which an off-board program waits for the vehicle."""
        return 14540 + self.instance

    @property
    def ground_station_door(self) -> int:
        """Port for one more ground station, which sends first."""
        return 18570 + self.instance

    @property
    def off_board_door(self) -> int:
        """Port for a controller, which sends first."""
        return 14580 + self.instance

    def stop(self) -> dict[str, Any]:
        """End the vehicle as Ctrl-C does, and return its last output."""
        self.process.terminate()
        out, err = self.process.communicate(timeout=60)
        assert err == ""
        said: dict[str, Any] = json.loads(out.splitlines()[-1])
        return said


def free_instance(first: int) -> int:
    """Return the number of a vehicle whose ports are free; workers with other numbers find others."""
    for instance in range(first, 250, 9):  # 10 would make one vehicle's port for programs another's for ground stations
        with ExitStack() as stack:
            try:
                for port in PORTS:
                    stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)).bind((HOST, port + instance))
            except OSError:
                continue
        return instance
    raise AssertionError("no free ports for a vehicle")


@pytest.fixture
def stand(worker_id: str) -> Callable[..., Any]:
    """Return a context manager that starts a vehicle on the ground with the given options, and ends it."""

    @contextmanager
    def started(*options: str) -> Iterator[Vehicle]:
        instance = free_instance(100 + int(worker_id.removeprefix("gw").replace("master", "8")))
        command = [sys.executable, "-m", "firmware_model", "--json", "--instance", str(instance), *options]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            try:
                assert process.stdout is not None
                greeting = process.stdout.readline()
                assert greeting, process.communicate()[1]
                assert json.loads(greeting)["listening"] == [18570 + instance, 14580 + instance]
                yield Vehicle(process, instance)
            finally:
                process.kill()

    return started


@pytest.fixture
def vehicle(stand: Callable[..., Any]) -> Iterator[Vehicle]:
    """Return a vehicle as `python -m firmware_model` starts it: on the ground, free to fly, in calm air."""
    with stand() as standing:
        yield standing


@pytest.fixture
def programs() -> Path:
    """Return the folder of the programs."""
    return PROGRAMS


@pytest.fixture
def run_program() -> Callable[..., dict[str, Any]]:
    """Return a function that runs a program of this folder and returns the JSON object that it prints."""

    def run(name: str, *arguments: object, timeout_s: float = 150.0) -> dict[str, Any]:
        interpreter = sys.executable if name.endswith(".py") else "node"
        ended = subprocess.run(
            [interpreter, str(PROGRAMS / name), *map(str, arguments)],
            capture_output=True, text=True, timeout=timeout_s, check=False,
        )  # fmt: skip
        assert ended.returncode == 0, ended.stdout + ended.stderr
        facts: dict[str, Any] = json.loads(next(line for line in ended.stdout.splitlines() if line.startswith("{")))
        return facts

    return run
