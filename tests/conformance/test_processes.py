"""Real processes over real sockets, with actions of a user, a ground station and a killer."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import psutil
import pytest

from firmware_model.autopilot.modes import Mode
from firmware_model.config.events import GpsLoss
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from firmware_model.recording.journal import read_journal
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.flight.routes.processes import fly
from gustproof.law.form import load_law

pytestmark = pytest.mark.usefixtures("started_as_users")

LONG = replace(load_scenario("paper"), duration_s=3600.0)  # nobody waits for its end
MINUTE = replace(load_scenario("paper"), duration_s=60.0)


def children() -> list[psutil.Process]:
    return [child for child in psutil.Process().children() if child.status() != psutil.STATUS_ZOMBIE]


def child(module: str) -> psutil.Process:
    (found,) = [process for process in children() if module in process.cmdline()]
    return found


class AtFirstProgress:
    """Performs an action once, after the first records of the flight."""

    def __init__(self, action: Callable[[], None]) -> None:
        self.action: Callable[[], None] | None = action

    def __call__(self, fraction: float) -> None:
        if fraction > 0.0 and self.action is not None:
            action, self.action = self.action, None
            action()


def fly_and(action: Callable[[], None], tmp_path, scenario=LONG):
    return fly(
        scenario,
        load_law("hinf-d1"),
        vehicle=load_vehicle("paper"),
        out=tmp_path,
        progress=AtFirstProgress(action),
    )


@pytest.fixture(autouse=True)
def _no_process_is_left_behind() -> Iterator[None]:
    before = set(children())  # what earlier tests keep in this process, a pool's tracker perhaps
    yield
    assert set(children()) <= before


def test_killed_controller_is_named_and_the_fail_safe_flies_to_the_end(tmp_path):
    flight = fly_and(lambda: child("gustproof.flight.endpoint").kill(), tmp_path, MINUTE)
    assert flight.outcome is FlightOutcome.CONTROLLER_LOST
    assert "fail-safe" in flight.message
    assert len(flight.records) == MINUTE.samples
    modes = flight.records["mode"]
    assert (modes[0], modes[-1]) == (Mode.OFFBOARD.value, Mode.STABILIZED.value)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_killed_autopilot_is_named_and_its_journal_is_readable(tmp_path, number):
    flight = fly_and(lambda: child("firmware_model").send_signal(number), tmp_path)
    assert flight.outcome is FlightOutcome.AUTOPILOT_LOST
    assert 0 < len(flight.records) < LONG.samples
    header, records = read_journal(flight.journal)
    assert header["scenario"] == LONG.name
    assert len(records) == len(flight.records)


def test_ctrl_c_ends_both_processes_which_share_an_allowed_core_and_keeps_what_was_flown(tmp_path):
    allowed = set(psutil.Process().cpu_affinity())
    cores: list[tuple[int, ...]] = []

    def look_and_interrupt() -> None:
        flying = child("firmware_model"), child("gustproof.flight.endpoint")
        cores.extend(tuple(process.cpu_affinity()) for process in flying)
        raise KeyboardInterrupt

    flight = fly_and(look_and_interrupt, tmp_path)
    assert flight.outcome is FlightOutcome.INTERRUPTED
    assert len(flight.records) > 0
    ((core,),) = set(cores)
    assert core in allowed
    assert set(psutil.Process().cpu_affinity()) == allowed


def test_law_of_another_rate_is_refused_before_anything_starts(tmp_path):
    law = replace(load_law("hinf-d1"), dt=0.01)
    with pytest.raises(ConfigError, match=r"steps every 0\.01 s"):
        fly(MINUTE, law, vehicle=load_vehicle("paper"), out=tmp_path)


def test_an_event_that_no_law_notices_is_refused_before_anything_starts(tmp_path):
    with pytest.raises(ConfigError, match=r"event\.0: gps_lost is of real autopilots"):
        fly(replace(MINUTE, event=(GpsLoss(kind="gps_lost", at_s=1.0),)), load_law("hinf-d1"), out=tmp_path)
    assert not list(tmp_path.iterdir())


def test_journal_is_never_overwritten(tmp_path):
    (tmp_path / "paper-hinf-d1-seed1.journal").touch()
    with pytest.raises(ConfigError, match="exists already"):
        fly(MINUTE, load_law("hinf-d1"), vehicle=load_vehicle("paper"), out=tmp_path)


@contextmanager
def autopilot(*arguments: str) -> Iterator[tuple[subprocess.Popen[str], dict]]:
    command = [sys.executable, "-m", "firmware_model", "--json", *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            greeting = process.stdout.readline()
            yield process, json.loads(greeting) if greeting else {}
        finally:
            process.kill()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_autopilot_ends_in_order_on_a_signal(number, tmp_path):
    with autopilot("--scenario", "calm", "--bind-port", "0", "--journal", str(tmp_path / "flight")) as (process, _):
        process.send_signal(number)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert json.loads(out.splitlines()[-1])["outcome"] == "interrupted"
    assert err == ""
    assert len(read_journal(tmp_path / "flight")[1]) == 0


# Other bad input is told to the commands in the tests' own process: tests/unit, test_main.py.
def test_autopilot_tells_bad_input_in_one_line():
    with autopilot("--bind-port", "0", "--scenario", "nowhere") as (process, greeting):
        _, err = process.communicate(timeout=60)
    assert greeting == {}
    assert process.returncode == 2
    assert "no scenario named 'nowhere'" in err
    assert len(err.splitlines()) == 1


def test_controller_tells_bad_input_in_one_line():
    command = [sys.executable, "-m", "gustproof.flight.endpoint", "--law", "nothing"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 2
    assert "no law named 'nothing'" in ended.stderr
    assert len(ended.stderr.splitlines()) == 1


@pytest.mark.parametrize("address", ["", "127.0.0.1:9\n"])
def test_attended_controller_ends_when_who_started_it_has(address):
    command = [
        sys.executable,
        "-m",
        "gustproof.flight.endpoint",
        "--law",
        "hinf-d1",
        "--connect",
        "-",
        "--exit-on-stdin-eof",
    ]
    ended = subprocess.run(command, input=address, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == (130 if address else 2)
    assert len(ended.stderr.splitlines()) == 1


def test_plain_mavutil_client_sees_arms_and_flies_the_vehicle():
    os.environ.setdefault("MAVLINK20", "1")
    from pymavlink import mavutil

    with autopilot("--scenario", "calm", "--bind-port", "0") as (_, greeting):
        link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{greeting['listening'][0]}", source_system=255)
        try:
            link.mav.heartbeat_send(6, 8, 0, 0, 4)
            beat = link.recv_match(type="HEARTBEAT", blocking=True, timeout=60)
            assert (beat.type, beat.autopilot) == (2, 12)
            stop = threading.Event()

            def stream() -> None:
                while not stop.is_set():
                    link.mav.set_attitude_target_send(0, 1, 1, 7, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, 0.5)
                    time.sleep(0.05)

            streaming = threading.Thread(target=stream)
            streaming.start()
            try:
                link.mav.command_long_send(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
                assert link.recv_match(type="COMMAND_ACK", blocking=True, timeout=60).result == 0
                for _ in range(100):  # refused for now while its set-points are held up, on a busy machine
                    link.mav.command_long_send(1, 1, 176, 0, 1, 6, 0, 0, 0, 0, 0)
                    result = link.recv_match(type="COMMAND_ACK", blocking=True, timeout=60).result
                    if result != 1:
                        break
                    time.sleep(0.1)
                assert result == 0
                seen = link.recv_match(
                    type="HEARTBEAT", condition="HEARTBEAT.base_mode & 128", blocking=True, timeout=60
                )
                assert seen.custom_mode == Mode.OFFBOARD.value
                flown = link.recv_match(
                    type="HIGHRES_IMU", condition="HIGHRES_IMU.time_usec > 0", blocking=True, timeout=60
                )
                assert flown.zacc == pytest.approx(-9.80665, abs=0.2)  # noise of .03 m/s^2 rms
            finally:
                stop.set()
                streaming.join()
        finally:
            link.close()
