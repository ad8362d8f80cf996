"""MAVProxy 1.8, operated through its keyboard."""

import hashlib
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from firmware_model.autopilot.parameters import Parameters
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle

pytestmark = pytest.mark.clients
PATIENCE_S = 60.0


class Console:
    """MAVProxy with its keyboard and its screen."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        self.screen = ""
        self._read_to = 0
        self._news = threading.Condition()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def type(self, line: str) -> None:
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def expect(self, pattern: str) -> re.Match[str]:
        """Return the next place on the screen that looks like this."""
        found = self._find(pattern, PATIENCE_S)
        assert found, f"no {pattern!r} in:\n{self.screen}"
        return found

    def type_until(self, line: str, pattern: str) -> None:
        """Type a line until its answer is this one: earlier lines take effect with a delay."""
        for _ in range(int(PATIENCE_S)):
            self.type(line)
            if self._find(pattern, 1.0):
                return
        raise AssertionError(f"no {pattern!r} in:\n{self.screen}")

    def leave(self) -> None:
        self.process.kill()  # it does not always end on request
        self._reader.join()

    def _find(self, pattern: str, timeout_s: float) -> re.Match[str] | None:
        deadline = time.monotonic() + timeout_s
        with self._news:
            while not (found := re.compile(pattern).search(self.screen, self._read_to)):
                if not self._news.wait(deadline - time.monotonic()):
                    return None
            self._read_to = found.end()
            return found

    def _read(self) -> None:
        while text := os.read(self.process.stdout.fileno(), 4096):
            with self._news:
                self.screen += text.decode(errors="replace")
                self._news.notify()


@contextmanager
def opened(vehicle, home: Path) -> Iterator[Console]:
    program = shutil.which("mavproxy.py", path=str(Path(sys.executable).parent))
    assert program is not None, "MAVProxy is not installed: tools/test does it"
    command = [sys.executable, "-u", program, f"--master=udp:127.0.0.1:{vehicle.ground_station}", "--no-state"]
    with subprocess.Popen(
        command, cwd=home, env={**os.environ, "HOME": str(home)},
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    ) as process:  # fmt: skip
        console = Console(process)
        try:
            console.expect(f"online system {vehicle.system}")
            yield console
        finally:
            console.leave()


@pytest.fixture
def console(vehicle, tmp_path: Path) -> Iterator[Console]:
    with opened(vehicle, tmp_path) as console:
        yield console


def test_its_user_lists_and_sets_parameters(console):
    parameters = Parameters(load_vehicle("paper"), load_scenario("calm"))
    console.type("param fetch")
    console.expect(rf"Received {len(parameters.table)} parameters")
    console.type("param set COM_OF_LOSS_T 2.5")
    console.type("param set COM_OBL_RC_ACT 4")
    console.type_until("param show COM_OBL_RC_ACT", r"COM_OBL_RC_ACT\s+4\b")
    console.type_until("param show COM_OF_LOSS_T", r"COM_OF_LOSS_T\s+2\.5")
    console.type("param set COM_OF_LOSS_T 61")
    console.expect("AP: COM_OF_LOSS_T out of range: 0.1 to 60")
    assert not re.search("fence breach|timed out|link 1 down$", console.screen.split("online system")[1])


def test_its_user_arms_changes_mode_and_pings(console):
    console.expect("Mode STABILIZED")
    console.type("ping")
    console.expect(r"ping response: .*from=\d+/1")
    console.type("mode")
    modes = console.expect(r"Available modes: (.+?)\r?\n")[1]  # the line may come in two pieces
    assert {"STABILIZED", "OFFBOARD", "LOITER", "LAND"} <= set(modes.split(", "))
    # Its "mode NAME" fails with the modes of any PX4: it takes the three numbers of one for a single number.
    console.type("long DO_SET_MODE 1 6 0")
    console.expect("DO_SET_MODE: TEMPORARILY_REJECTED")
    console.expect("AP: .*OFFBOARD rejected")
    console.type("long DO_SET_MODE 1 3 0")
    console.expect("Mode POSCTL")
    console.type("arm throttle")
    console.expect("COMPONENT_ARM_DISARM: ACCEPTED")
    console.expect("ARMED")
    console.type("disarm")
    console.expect("DISARMED")
    console.type("wp list")
    console.expect("Requesting 0 waypoints")
    console.type("log list")
    console.expect("No logs")
    assert not re.search("fence breach|timed out|link 1 down$", console.screen.split("online system")[1])


def test_its_user_is_obeyed_once_the_key_is_typed(stand, tmp_path):
    key = tmp_path / "key"
    key.write_bytes(hashlib.sha256(b"open-sesame").digest())
    key.chmod(0o600)
    with stand("--signing-key", str(key)) as vehicle, opened(vehicle, tmp_path) as console:
        console.type("arm throttle")
        console.type("signing key open-sesame")
        console.expect("Setup signing key")
        assert "ARMED" not in console.screen
        console.type("arm throttle")
        console.expect("COMPONENT_ARM_DISARM: ACCEPTED")
        console.expect("ARMED")
        rejected = vehicle.stop()["links"][f"127.0.0.1:{vehicle.ground_station}"]["rejected"]
    assert rejected["not_signed"] > 0
    assert not rejected.keys() & {"wrong_signature", "replayed", "out_of_date"}
