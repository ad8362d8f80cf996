"""Signing between the vehicle's process and pymavlink's `mavutil`, written as its users do."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.mavlink.frames import RejectReason, parse
from firmware_model.mavlink.signing import Signing
from firmware_model.process import udp
from firmware_model.session.vehicle_endpoint import VehicleEndpoint
from gustproof.flight.endpoint.endpoint import ControllerEndpoint, ControllerOutcome
from gustproof.law.form import load_law

KEY = bytes(range(32))
UNIX_US = 1_700_000_000_000_000
PATIENCE_S = 60.0

CLIENT = """
import json, os, sys, time
os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil

port, key, patience_s = int(sys.argv[1]), bytes.fromhex(sys.argv[2]), float(sys.argv[3])
link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=255, dialect="all")
if key:
    link.setup_signing(key, sign_outgoing=True)
link.mav.heartbeat_send(6, 8, 0, 0, 4)
beat = link.recv_match(type="HEARTBEAT", blocking=True, timeout=patience_s)
answer, tries = None, patience_s
while answer is None and tries > 0:
    link.mav.command_long_send(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
    answer, tries = link.recv_match(type="COMMAND_ACK", blocking=True, timeout=1), tries - 1
print(json.dumps({
    "beat": beat is not None and beat.get_signed(),
    "result": None if answer is None else answer.result,
    "bad": link.mav.signing.badsig_count,
}))
"""


class Vehicle:
    """Process of a vehicle on the ground at a free port, with its last output."""

    def __init__(self, *options: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "firmware_model", "--bind-port", "0", "--json", *options],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self.process.stdout
        self.port = json.loads(self.process.stdout.readline())["listening"][0]

    def client(self, key: bytes, patience_s: float) -> dict:
        script = [sys.executable, "-c", CLIENT, str(self.port), key.hex(), str(patience_s)]
        done = subprocess.run(script, capture_output=True, text=True, timeout=PATIENCE_S, check=True)
        return json.loads(done.stdout.splitlines()[-1])

    def last_words(self) -> dict:
        self.process.send_signal(signal.SIGINT)
        out, _ = self.process.communicate(timeout=PATIENCE_S)
        return json.loads(out.splitlines()[-1])


@contextmanager
def standing(*options: str) -> Iterator[Vehicle]:
    vehicle = Vehicle(*options)
    try:
        yield vehicle
    finally:
        vehicle.process.kill()
        vehicle.process.communicate()


@pytest.fixture
def key(tmp_path) -> Path:
    path = tmp_path / "key"
    path.write_text(KEY.hex() + "\n")
    path.chmod(0o600)
    return path


def test_right_key_is_obeyed_wrong_and_missing_ones_are_refused_and_counted(key):
    with standing("--signing-key", str(key)) as vehicle:
        refused = [vehicle.client(b"", 2.0), vehicle.client(bytes(32), 2.0)]
        obeyed = vehicle.client(KEY, 30.0)
        told = vehicle.last_words()
    assert [client["result"] for client in refused] == [None, None]
    assert obeyed == {"beat": True, "result": 0, "bad": 0}
    assert told["counters"]["not_signed"] == 2
    assert told["counters"]["wrong_signature"] == 3  # its heartbeat too


def test_overheard_frame_is_refused_from_another_address(key):
    sender = wire.MAVLink(None, 255, 190)
    sender.signing.secret_key, sender.signing.sign_outgoing = KEY, True
    sender.signing.timestamp = (udp.unix_us() + time.monotonic_ns() // 1000 - 1_420_070_400_000_000) // 10
    beat = wire.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    overheard = beat.pack(sender)
    with standing("--signing-key", str(key)) as vehicle, udp.bind(0) as first, udp.bind(0) as second:
        for end, datagrams in ((first, [overheard]), (second, [overheard, overheard, beat.pack(sender)])):
            end.settimeout(PATIENCE_S)
            for datagram in datagrams:
                end.sendto(datagram, ("127.0.0.1", vehicle.port))
            (frame, *_) = parse(end.recv(2048))
            assert frame.is_signed
        told = vehicle.last_words()
    assert told["counters"]["replayed"] == 2
    assert [link["in"] for link in told["links"].values()] == [1, 1]


def test_figures_of_each_link_are_told_at_the_end():
    with standing() as vehicle:
        assert vehicle.client(b"", 30.0)["result"] == 0
        told = vehicle.last_words()
    (figures,) = told["links"].values()
    assert figures["in"] >= 2
    assert figures["out"] > figures["in"]
    assert (figures["lost"], figures["bad"]) == (0, 0)


@pytest.mark.parametrize("key", [KEY, bytes(32), None], ids=["right key", "wrong key", "no key"])
def test_controller_flies_with_the_key_of_its_vehicle_alone(key):
    vehicle_at, controller_at = (0, ("vehicle", 1)), (0, ("controller", 1))
    calm = replace(load_scenario("calm"), duration_s=0.2)
    vehicle = VehicleEndpoint(
        load_vehicle("paper"), calm, 1, lambda _: None, lockstep=True, signing=Signing(KEY, UNIX_US)
    )
    signing = None if key is None else Signing(key, UNIX_US, frozenset())
    controller = ControllerEndpoint(load_law("hinf-d1"), vehicle_at, signing)
    now_us = 0
    while not controller.finished:
        for datagram, _ in controller.poll(now_us):
            vehicle.receive(datagram, controller_at, now_us)
        for datagram, _ in vehicle.poll(now_us):
            controller.receive(datagram, vehicle_at, now_us)
        now_us += 1_000
    assert controller.outcome is (ControllerOutcome.DONE if key == KEY else ControllerOutcome.NOT_STARTED)
    refusals = {RejectReason.NOT_SIGNED: key is None, RejectReason.WRONG_SIGNATURE: key == bytes(32)}
    assert {cause: cause in vehicle.counters for cause in refusals} == refusals
