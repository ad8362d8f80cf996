"""The controller's command in this process: what it prints and returns, whoever carries its datagrams."""

import io
import json
import signal
import socket
from collections.abc import Callable
from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from firmware_model.mavlink.channel import Channel
from firmware_model.mavlink.frames import RejectReason
from firmware_model.process import udp
from firmware_model.session.outcome import VehicleOutcome
from firmware_model.session.vehicle_endpoint import VehicleEndpoint
from gustproof.flight.endpoint import __main__ as command
from gustproof.flight.endpoint.endpoint import ControllerEndpoint, ControllerOutcome

ADDRESS = "127.0.0.1:9"
VEHICLE, CONTROLLER = (0, ("127.0.0.1", 9)), (0, ("127.0.0.1", 2))


pytestmark = pytest.mark.usefixtures("handlers_and_collector_stay")


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
        (["--connect", ADDRESS, "--bind-port", "70000"], "port 70000"),
    ],
)
def test_bad_input_is_told_in_one_line(arguments, words, capsys):
    assert command.main(arguments) == 2
    error = capsys.readouterr().err
    assert words in error
    assert len([line for line in error.splitlines() if "compiling" not in line]) == 1  # a new clone compiles first


def test_references_of_a_file_are_flown_however_large(vehicle, tmp_path):
    script = tmp_path / "steep.toml"
    script.write_text(
        'description = "a steep step"\nduration_s = 0.2\n[[event]]\nkind = "attitude"\nat_s = 0.1\n'
        "euler_deg = [50.0, 0.0, 0.0]\n",
        encoding="utf-8",
    )
    assert command.main(["--law", "flagship", "--connect", ADDRESS, "--scenario", str(script)]) == 0


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


class Served:
    """A loop in place of the network's that ends each flight as the test says: what it served, and that end."""

    def __init__(self, monkeypatch) -> None:
        self.outcome = ControllerOutcome.DONE
        self.message = "it ended"
        self.counted: list[RejectReason] = []
        self.ports: list[tuple[int, str]] = []
        self.busy: set[int] = set()
        self.endpoint: ControllerEndpoint | None = None
        self.exchange: udp.Exchange | None = None
        monkeypatch.setattr(udp, "serve_lockstep", self.serve)
        monkeypatch.setattr(udp, "bind", self.bind)
        monkeypatch.setattr(udp, "connect", lambda *_: None)

    def serve(self, endpoint: ControllerEndpoint, _: socket.socket, exchange: udp.Exchange) -> None:
        self.endpoint, self.exchange = endpoint, exchange
        endpoint.outcome, endpoint.message = self.outcome, self.message
        endpoint.channel.dropped.update(self.counted)

    def bind(self, port: int, host: str) -> socket.socket:
        self.ports.append((port, host))
        if port in self.busy:
            raise ConfigError(f"port {port} is in use")
        return socket.socket(socket.AF_INET, socket.SOCK_DGRAM)


@pytest.fixture
def served(monkeypatch) -> Served:
    return Served(monkeypatch)


@pytest.mark.parametrize(
    ("outcome", "status"),
    [
        (ControllerOutcome.DONE, 0),
        (ControllerOutcome.WRONG_RATE, 2),
        (ControllerOutcome.NOT_SUPPORTED, 2),
        (ControllerOutcome.NOT_STARTED, 3),
        (ControllerOutcome.AUTOPILOT_LOST, 3),
        (ControllerOutcome.MODE_LOST, 3),
        (ControllerOutcome.INTERRUPTED, 130),
    ],
)
@pytest.mark.parametrize("as_json", [False, True])
def test_outcome_is_told_and_is_the_exit_status(served, outcome, status, as_json, capsys):
    served.outcome, served.counted = outcome, [RejectReason.STALE]
    assert command.main(["--law", "hinf-d1", *(["--json"] if as_json else [])]) == status
    out, err = capsys.readouterr()
    if as_json:
        (line,) = out.splitlines()
        told = json.loads(line)
        assert (told["outcome"], told["message"], told["counters"]) == (outcome.value, "it ended", {"stale": 1})
        assert (told["late_samples"], told["missed_samples"], told["link"]["in"]) == (0, 0, 0)
        assert err == ""
    elif status:
        assert err.splitlines()[-1] == "gustproof controller: it ended"
    else:
        assert out == "law 'hinf-d1': flown to the end, 0 samples late, 0 missed\n"


@pytest.mark.parametrize(
    ("arguments", "ports"),
    [
        (["--connect", "127.0.0.1:14580"], [14540]),
        (["--connect", "127.0.0.1:14589"], [14549]),
        (["--connect", "127.0.0.1:14590"], [0]),
        (["--connect", "127.0.0.1:14579"], [0]),
        (["--connect", "127.0.0.1:14580", "--bind-port", "0"], [0]),
        (["--connect", "127.0.0.1:14580", "--bind-port", "14777"], [14777]),
    ],
)
def test_px4s_simulation_is_met_from_its_own_peer_port(served, arguments, ports):
    assert command.main(["--law", "hinf-d1", *arguments]) == 0
    assert served.ports == [(port, "127.0.0.1") for port in ports]


def test_peer_port_in_use_is_told_and_a_free_one_taken(served, capsys):
    served.busy = {14540}
    assert command.main(["--law", "hinf-d1"]) == 0
    assert [port for port, _ in served.ports] == [14540, 0]
    assert "port 14540 is in use; a free port is used" in capsys.readouterr().err
    assert command.main(["--law", "hinf-d1", "--bind-port", "14540"]) == 2  # who asks for a port gets that one or none


def test_with_a_key_not_even_an_unsigned_heartbeat_is_read(served, tmp_path):
    key = tmp_path / "key"
    key.write_bytes(bytes(range(32)))
    key.chmod(0o600)
    assert command.main(["--law", "hinf-d1", "--signing-key", str(key)]) == 0
    beat = Channel(1, 1).pack(wire.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3))
    served.endpoint.receive(beat, (0, ("127.0.0.1", 14580)), 0)
    assert served.endpoint.channel.dropped == {RejectReason.NOT_SIGNED: 1}


def test_law_is_flown_by_the_message_that_it_commands(served):
    assert command.main(["--law", "hinf-d1", "--via", "torque"]) == 0


def test_options_of_its_parent_and_of_the_machine_are_taken(served, monkeypatch):
    asked = []
    monkeypatch.setattr(command, "exit_on_stdin_eof", asked.append)
    monkeypatch.setattr(command.realtime, "request_fifo_scheduling", lambda: asked.append("fifo"))
    served.outcome = None
    assert command.main(["--law", "hinf-d1", "--exit-on-stdin-eof", "--real-time"]) == 130  # served no end of its own
    end, fifo = asked
    assert fifo == "fifo"
    end()
    assert served.endpoint.outcome is ControllerOutcome.INTERRUPTED


@pytest.mark.parametrize(
    "connect",
    ["here", "127.0.0.1", "127.0.0.1:0", "127.0.0.1:65536", ":14580", "udp://a:1", "udp://:14540", "a:b"],
)
def test_address_that_is_none_is_refused(served, connect, capsys):
    assert command.main(["--law", "hinf-d1", "--connect", connect]) == 2
    told = f"gustproof controller: --connect is '{connect}', must be [udp:|udpin:|tcp:]HOST:PORT, as 127.0.0.1:14580\n"
    assert capsys.readouterr().err == told
    assert served.endpoint is None


@pytest.mark.parametrize("options", [(), ("--real-time",)])
def test_samples_are_exchanged_in_machine_code_only_where_it_is_loaded(options, served, monkeypatch):
    """It would be compiled in flight, where a stall lets samples wait, and take ten seconds."""
    loaded: list[object] = []
    monkeypatch.setattr(command, "load_exchange", loaded.append)
    assert command.main(["--law", "hinf-d1", "--connect", ADDRESS, *options]) == 0
    assert bool(loaded) == (served.exchange != udp.no_exchange) == (not options)
