"""The controller's command, with a loop in place of the network's that ends each flight as the test says."""

import json
import signal
import socket

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.errors import ConfigError
from firmware_model.mavlink.channel import Channel
from firmware_model.mavlink.frames import RejectReason
from firmware_model.process import realtime, udp
from gustproof.controller.__main__ import main
from gustproof.controller.endpoint import ControllerEndpoint, ControllerOutcome


class Served:
    """What the command served, and the end that it is given."""

    def __init__(self, monkeypatch) -> None:
        self.outcome = ControllerOutcome.DONE
        self.message = "it ended"
        self.counted: list[RejectReason] = []
        self.ports: list[tuple[int, str]] = []
        self.busy: set[int] = set()
        self.endpoint: ControllerEndpoint | None = None
        monkeypatch.setattr(udp, "serve_lockstep", self.serve)
        monkeypatch.setattr(udp, "bind", self.bind)
        monkeypatch.setattr(udp, "connect", lambda *_: None)
        monkeypatch.setattr(realtime, "freeze_gc", lambda **_: None)
        monkeypatch.setattr(signal, "signal", lambda *_: None)

    def serve(self, endpoint: ControllerEndpoint, _: socket.socket) -> None:
        self.endpoint = endpoint
        endpoint.outcome, endpoint.message = self.outcome, self.message
        endpoint.counters.update(self.counted)

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
    assert main(["--law", "hinf-d1", *(["--json"] if as_json else [])]) == status
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
    assert main(["--law", "hinf-d1", *arguments]) == 0
    assert served.ports == [(port, "127.0.0.1") for port in ports]


def test_peer_port_in_use_is_told_and_a_free_one_taken(served, capsys):
    served.busy = {14540}
    assert main(["--law", "hinf-d1"]) == 0
    assert [port for port, _ in served.ports] == [14540, 0]
    assert "port 14540 is in use; a free port is used" in capsys.readouterr().err
    assert main(["--law", "hinf-d1", "--bind-port", "14540"]) == 2  # who asks for a port gets that one or none


def test_with_a_key_not_even_an_unsigned_heartbeat_is_read(served, tmp_path):
    key = tmp_path / "key"
    key.write_bytes(bytes(range(32)))
    key.chmod(0o600)
    assert main(["--law", "hinf-d1", "--signing-key", str(key)]) == 0
    beat = Channel(1, 1).pack(wire.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3))
    served.endpoint.receive(beat, (0, ("127.0.0.1", 14580)), 0)
    assert served.endpoint.counters == {RejectReason.NOT_SIGNED: 1}


@pytest.mark.parametrize("as_file", [False, True])
def test_references_that_the_law_does_not_hold_are_refused_unless_asked_for(served, as_file, tmp_path, capsys):
    step = {"kind": "attitude", "at_s": 0.1, "euler_deg": [60.0, 30.0, 0.0]}
    path = tmp_path / "steps.json"
    path.write_text(json.dumps({"name": "steps", "description": "", "duration_s": 1.0, "event": [step]}))
    name = str(path) if as_file else "attitude-steps"
    assert main(["--law", "flagship", "--scenario", name, "--anyway"]) == 0
    refused = main(["--law", "flagship", "--scenario", name]) == 2
    assert refused is as_file
    assert ("holds references within" in capsys.readouterr().err) is refused


def test_law_is_flown_only_by_the_message_that_it_commands(served, capsys):
    assert main(["--law", "hinf-d1", "--via", "torque"]) == 0
    assert main(["--law", "hinf-d1", "--via", "rates"]) == 2
    assert "commands torque, it can't fly via rates" in capsys.readouterr().err


def test_options_of_its_parent_and_of_the_machine_are_taken(served, monkeypatch):
    asked = []
    monkeypatch.setattr("gustproof.controller.__main__.exit_on_stdin_eof", asked.append)
    monkeypatch.setattr(realtime, "request_fifo_scheduling", lambda: asked.append("fifo"))
    served.outcome = None
    assert main(["--law", "hinf-d1", "--exit-on-stdin-eof", "--real-time"]) == 130  # served no end of its own
    interrupt, fifo = asked
    assert fifo == "fifo"
    interrupt()
    assert served.endpoint.outcome is ControllerOutcome.INTERRUPTED


@pytest.mark.parametrize("connect", ["127.0.0.1", "127.0.0.1:0", "127.0.0.1:65536", ":14580", "udp://a:1", "a:b"])
def test_address_that_is_none_is_refused(served, connect, capsys):
    assert main(["--law", "hinf-d1", "--connect", connect]) == 2
    assert f"--connect is '{connect}', must be HOST:PORT" in capsys.readouterr().err
    assert served.endpoint is None
