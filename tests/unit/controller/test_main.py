"""The controller's command in this process: what it prints and returns, whoever carries its datagrams."""

import io
import json
import signal
from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.process import udp
from firmware_model.session.outcome import VehicleOutcome
from firmware_model.session.vehicle_endpoint import VehicleEndpoint
from gustproof.controller import __main__ as command

ADDRESS = "127.0.0.1:9"
VEHICLE, CONTROLLER = (0, ("127.0.0.1", 9)), (0, ("127.0.0.1", 2))


@pytest.fixture(autouse=True)
def _handlers_and_collector_stay(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(command.realtime, "freeze_gc", lambda **_: None)
    monkeypatch.setattr(command.realtime, "request_fifo_scheduling", lambda: False)
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def vehicle(monkeypatch: pytest.MonkeyPatch) -> VehicleEndpoint:
    """Return the vehicle that the command meets: clamped, for a calm flight of 50 samples."""
    calm = replace(load_scenario("calm"), duration_s=0.2)
    vehicle = VehicleEndpoint(load_vehicle("paper"), calm, 1, lambda _: None, lockstep=True)

    def carry(endpoint: udp.Endpoint, *_: object) -> None:
        now_us = 0
        while not endpoint.finished:
            for datagram, _ in endpoint.poll(now_us):
                vehicle.receive(datagram, CONTROLLER, now_us)
            for datagram, _ in vehicle.poll(now_us):
                endpoint.receive(datagram, VEHICLE, now_us)
            now_us += 1_000

    monkeypatch.setattr(udp, "serve_lockstep", carry)
    return vehicle


def wait(endpoint: udp.Endpoint, *_: object) -> None:
    """Carry nothing, as if nobody were there."""
    while not endpoint.finished:
        endpoint.poll(endpoint.deadline_us())


def interrupt(*_: object) -> None:
    signal.raise_signal(signal.SIGTERM)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--law", "nothing"], "no law named 'nothing'"),
        (["--law", "hinf-d1", "--via", "rates"], "commands torque, it can't fly via rates"),
        (["--law", "hinf-d1", "--connect", "here"], "must be HOST:PORT"),
        (["--connect", "udp://:14540"], "must be HOST:PORT, as 127.0.0.1:14580"),
        (["--connect", ADDRESS, "--bind-port", "70000"], "port 70000"),
    ],
)
def test_bad_input_is_told_in_one_line(arguments, words, capsys):
    assert command.main(arguments) == 2
    error = capsys.readouterr().err
    assert words in error
    assert len(error.splitlines()) == 1


def test_references_that_the_law_does_not_hold_are_flown_only_by_order(vehicle, tmp_path, capsys):
    script = tmp_path / "steep.toml"
    script.write_text(
        'description = "a steep step"\nduration_s = 0.2\n[[event]]\nkind = "attitude"\nat_s = 0.1\n'
        "euler_deg = [50.0, 0.0, 0.0]\n",
        encoding="utf-8",
    )
    options = ["--law", "flagship", "--connect", ADDRESS, "--scenario", str(script)]
    assert command.main(options) == 2
    assert capsys.readouterr().err.endswith("; --anyway flies it all the same\n")
    assert command.main([*options, "--anyway"]) == 0


def test_flight_is_flown_to_the_end_and_told_step_by_step(vehicle, capsys):
    assert command.main(["--law", "hinf-d1", "--connect", ADDRESS]) == 0
    told = capsys.readouterr()
    assert vehicle.outcome is VehicleOutcome.DONE
    assert told.out == "law 'hinf-d1': flown to the end, 0 samples late, 0 missed\n"
    lines = [line.removeprefix("gustproof controller: ") for line in told.err.splitlines()]
    assert lines[0] == f"waiting for an autopilot at {ADDRESS}"
    assert lines[1].startswith("found PX4, system 1: reading GP_TRQ_MAX_R")
    assert lines[2:] == ["arming the vehicle", "requesting OFFBOARD", "hinf-d1 in control"]


def test_json_is_one_object_and_silence_beside_it(vehicle, monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", io.StringIO(f"{ADDRESS}\n"))
    options = ["--law", "hinf-rates", "--via", "rates", "--connect", "-", "--scenario", "calm", "--real-time"]
    assert command.main([*options, "--json"]) == 0
    told = capsys.readouterr()
    assert told.err == ""
    facts = json.loads(told.out)
    assert (facts["outcome"], facts["late_samples"], facts["missed_samples"]) == ("done", 0, 0)
    assert set(facts["counters"]) == {"unused_message"}  # STATUSTEXT of another's, and answers that it needs no more
    assert facts["link"]["in"] > 50


@pytest.mark.parametrize(
    ("serve", "status", "words"),
    [(wait, 3, "no autopilot answers"), (interrupt, 130, "interrupted")],
)
def test_flight_that_does_not_begin_has_its_reason(
    serve: Callable[..., None], status: int, words: str, monkeypatch, capsys
):
    monkeypatch.setattr(udp, "serve_lockstep", serve)
    assert command.main(["--law", "hinf-d1", "--connect", ADDRESS]) == status
    assert capsys.readouterr().err.splitlines()[-1] == f"gustproof controller: {words}"
