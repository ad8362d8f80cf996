"""Real processes at the pace of the clock, on free ports. No test depends on the machine's speed."""

import json
import math
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from pydantic_core import to_jsonable_python
from pymavlink.dialects.v20 import all as wire

from firmware_model.__main__ import format_greeting
from firmware_model.autopilot.modes import Mode
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.mavlink.frames import parse
from firmware_model.recording.journal import count_records, read_journal
from gustproof.design.derive import derive
from gustproof.design.designs import load_design
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.flight.routes.processes import fly
from gustproof.law.form import load_law

PATIENCE_S = 60.0
HOLD, OFFBOARD = (4.0, 3.0), (6.0, 0.0)


@contextmanager
def process(module: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", module, "--json", *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        try:
            yield running
        finally:
            running.kill()


def last_words(running: subprocess.Popen[str]) -> dict:
    running.send_signal(signal.SIGINT)
    out, err = running.communicate(timeout=PATIENCE_S)
    assert err == ""
    return json.loads(out.splitlines()[-1])


class Pilot:
    """A ground station on a socket of its own."""

    def __init__(self, link: socket.socket, port: int) -> None:
        self.link, self.vehicle = link, ("127.0.0.1", port)
        self.packer = wire.MAVLink(None, 255, 190)
        self.texts: list[str] = []
        self.mode, self.armed, self.components = 0, False, set[int]()
        self.roll_deg = 0.0
        self.acks: list[tuple[int, int]] = []
        self._beat_at = 0.0

    def say(self, message) -> None:
        self.link.sendto(message.pack(self.packer), self.vehicle)

    def listen(self) -> None:
        if time.monotonic() > self._beat_at:
            self._beat_at = time.monotonic() + 0.5
            self.say(wire.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        try:
            datagram = self.link.recv(2048)
        except TimeoutError:
            return
        for message in (frame.message() for frame in parse(datagram)):
            match message.get_type():
                case "HEARTBEAT":
                    self.components.add(message.get_srcComponent())
                    if message.get_srcComponent() == 1:
                        self.mode, self.armed = message.custom_mode, bool(message.base_mode & 128)
                case "ATTITUDE":
                    self.roll_deg = math.degrees(message.roll)
                case "STATUSTEXT":
                    self.texts.append(message.text)
                case "COMMAND_ACK":
                    self.acks.append((message.command, message.result))

    def until(self, reached: Callable[[], bool], what: str) -> None:
        end = time.monotonic() + PATIENCE_S
        while not reached():
            assert time.monotonic() < end, f"{what}: not within {PATIENCE_S:g} s; heard {self.texts}"
            self.listen()

    def order(self, command: int, *numbers: float) -> None:
        """Give a command until it is accepted."""
        filled = (*numbers, *[math.nan] * (7 - len(numbers)))
        end = time.monotonic() + PATIENCE_S
        while (command, wire.MAV_RESULT_ACCEPTED) not in self.acks:
            assert time.monotonic() < end, f"{command} is not accepted: {self.acks}, {self.texts}"
            self.say(wire.MAVLink_command_long_message(1, 1, command, 0, *filled))
            again = time.monotonic() + 0.5
            while time.monotonic() < again and (command, wire.MAV_RESULT_ACCEPTED) not in self.acks:
                self.listen()
        self.acks.clear()

    def set_mode(self, main: float, sub: float) -> None:
        self.order(wire.MAV_CMD_DO_SET_MODE, 1.0, main, sub)


@pytest.mark.parametrize(
    ("told", "ways"),
    [
        (
            (14553, 14543),
            ("UDP port 14553", "--master udp:127.0.0.1:14553", "udpin://0.0.0.0:14543", '"udpin:127.0.0.1:14553"'),
        ),
        ((), ("127.0.0.1:14583", "--master udpout:127.0.0.1:14583", "udpout://127.0.0.1:14583", '"udpout:127.0.0.1')),
    ],
)
def test_standing_vehicle_says_how_each_client_connects(told, ways):
    lines = format_greeting("vehicle", [18573, 14583], told).splitlines()
    clients = dict(zip(("QGroundControl", "MAVProxy", "MAVSDK", "pymavlink"), ways, strict=True))
    for client, way in clients.items():
        (line,) = [line for line in lines if line.startswith(f"  {client}")]
        assert way in line
    assert any("gustproof controller" in line and "--connect 127.0.0.1:14583" in line for line in lines)


@pytest.mark.parametrize("rate_hz", [250, 1000])
def test_scripted_flight_in_real_time_is_flown_to_the_end_and_tells_its_delays(tmp_path, rate_hz):
    scenario = replace(load_scenario("paper-turbulence"), duration_s=2.0, control_rate_hz=rate_hz)
    law, _ = derive(replace(load_design("D1"), dt=scenario.dt))
    flight = fly(scenario, law, vehicle=load_vehicle("paper"), out=tmp_path, real_time=True, default_ports=False)
    assert flight.outcome is FlightOutcome.DONE
    assert len(flight.records) == scenario.samples
    assert set(flight.records["mode"]) == {Mode.OFFBOARD.value}
    assert flight.timing is not None
    assert 0 <= flight.timing["late_p50_us"] <= flight.timing["late_p99_us"] <= flight.timing["late_worst_us"]
    assert (flight.timing["missed"] == 0) is (flight.timing["late_worst_us"] <= scenario.sample_us)
    assert flight.timing["fifo"] in (True, False)
    assert flight.timing["missed_samples"] == 0


def test_law_that_hangs_for_a_moment_steps_all_that_waited_and_keeps_its_attitude(tmp_path):
    scenario = replace(load_scenario("paper-turbulence"), duration_s=5.0)
    script, journal = tmp_path / "windy.json", tmp_path / "windy.journal"
    script.write_text(json.dumps(to_jsonable_python(scenario)))
    flown = ("--scenario", str(script))
    with process("firmware_model", "--bind-port", "0", "--journal", str(journal), *flown) as vehicle:
        (port,) = json.loads(vehicle.stdout.readline())["listening"]
        address = f"127.0.0.1:{port}"
        with process(
            "gustproof.flight.endpoint", "--law", "flagship", "--real-time", "--connect", address, *flown
        ) as law:
            end = time.monotonic() + PATIENCE_S
            while count_records(journal) < 250:
                assert time.monotonic() < end
                time.sleep(0.01)
            law.send_signal(signal.SIGSTOP)
            time.sleep(0.4)  # well below the second after which the fail-safe begins
            law.send_signal(signal.SIGCONT)
            told = [json.loads(each.communicate(timeout=PATIENCE_S)[0].splitlines()[-1]) for each in (vehicle, law)]
    assert [each["outcome"] for each in told] == ["done", "done"]
    assert told[1]["missed_samples"] == 0
    assert told[1]["late_samples"] > 80
    assert "rate_limited" not in told[0]["counters"] | told[1]["counters"]
    _, records = read_journal(journal)
    unstopped = fly_direct(scenario, load_law("flagship"), vehicle=load_vehicle("paper"))
    # Small angles: q is 1 and half of roll, pitch, yaw.
    apart = np.degrees(2.0 * np.abs(records["q_NB"] - unstopped["q_NB"])[:, 1:].max(axis=1))
    assert apart[-1] < 0.5
    assert apart.max() < 3.0  # with the torque of one moment for .5 s it would be 5 in the median, and 14 at worst
    assert told[0]["counters"]["stalled"] >= 1


def test_pilot_flies_a_standing_vehicle_gives_it_to_a_law_takes_it_back_and_lands():
    with process("firmware_model", "--bind-port", "0") as vehicle, socket.socket(type=socket.SOCK_DGRAM) as link:
        link.settimeout(0.05)
        (port,) = json.loads(vehicle.stdout.readline())["listening"]
        pilot = Pilot(link, port)
        pilot.order(wire.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        pilot.order(wire.MAV_CMD_NAV_TAKEOFF)
        pilot.until(lambda: pilot.mode == Mode.HOLD.value, "take-off")
        with process("gustproof.flight.endpoint", "--law", "hinf-scheduled", "--connect", f"127.0.0.1:{port}") as law:
            pilot.until(lambda: pilot.mode == Mode.OFFBOARD.value, "the law takes the vehicle")
            pilot.until(lambda: "hinf-scheduled in control" in pilot.texts, "the law says so")
            pilot.set_mode(*HOLD)
            pilot.until(lambda: "hinf-scheduled standing by" in pilot.texts, "the law gives way")
            pilot.set_mode(*OFFBOARD)
            pilot.until(lambda: pilot.texts.count("hinf-scheduled in control") == 2, "the law flies again")
            pilot.until(lambda: 191 in pilot.components, "the controller's own heartbeat")
            pilot.order(wire.MAV_CMD_NAV_LAND)
            pilot.until(lambda: not pilot.armed, "landing")
            assert last_words(law)["outcome"] == "interrupted"
        told = last_words(vehicle)
    assert told["outcome"] == "interrupted"
    assert "landed: disarmed" in pilot.texts


@contextmanager
def hovering(*arguments: str) -> Iterator[tuple[subprocess.Popen[str], Pilot]]:
    """Start a vehicle, and take off."""
    with (
        process("firmware_model", "--bind-port", "0", *arguments) as vehicle,
        socket.socket(type=socket.SOCK_DGRAM) as link,
    ):
        link.settimeout(0.05)
        (port,) = json.loads(vehicle.stdout.readline())["listening"]
        pilot = Pilot(link, port)
        pilot.order(wire.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        pilot.order(wire.MAV_CMD_NAV_TAKEOFF)
        pilot.until(lambda: pilot.mode == Mode.HOLD.value, "take-off")
        yield vehicle, pilot


def test_laws_that_take_over_a_leaning_vehicle_level_it():
    with hovering("--air", "gust-front") as (vehicle, pilot):
        for name in ("flagship", "hinf-scheduled", "aided"):
            pilot.set_mode(*HOLD)
            pilot.until(lambda: pilot.mode == Mode.HOLD.value and pilot.roll_deg < -5.0, "HOLD leans into the wind")
            address = f"127.0.0.1:{pilot.vehicle[1]}"
            with process("gustproof.flight.endpoint", "--law", name, "--connect", address) as law:
                pilot.until(lambda name=name: f"{name} in control" in pilot.texts, "the law takes the vehicle")
                pilot.until(lambda: abs(pilot.roll_deg) < 2.0, "the law levels it")
                assert last_words(law)["outcome"] == "interrupted"
        last_words(vehicle)


def test_law_that_hangs_or_dies_leaves_the_vehicle_to_its_fail_safe():
    with hovering() as (vehicle, pilot):
        for number in (signal.SIGSTOP, signal.SIGKILL):
            pilot.set_mode(*HOLD)
            pilot.until(lambda: pilot.mode == Mode.HOLD.value, "HOLD")
            pilot.texts.clear()
            address = f"127.0.0.1:{pilot.vehicle[1]}"
            with process("gustproof.flight.endpoint", "--law", "hinf-d1", "--connect", address) as law:
                pilot.until(lambda: pilot.mode == Mode.OFFBOARD.value, "the law takes the vehicle")
                law.send_signal(number)
                pilot.until(lambda: pilot.mode == Mode.STABILIZED.value, "fail-safe")
                assert "set-points lost: failsafe STABILIZED" in pilot.texts
        assert last_words(vehicle)["outcome"] == "interrupted"
