"""The vehicle's command in this process: what it prints, returns and leaves, whoever carries its datagrams."""

import json
import signal

import pytest

from firmware_model import __main__ as command
from firmware_model.autopilot.parameters import Parameters
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.process import udp
from firmware_model.recording.journal import read_journal
from gustproof.flight.endpoint.endpoint import ControllerEndpoint
from gustproof.flight.routes.direct import fly_direct
from gustproof.law.form import load_law

VEHICLE, CONTROLLER = (0, ("127.0.0.1", 1)), (0, ("127.0.0.1", 2))
SCENARIO = 'description = "a moment of calm"\nduration_s = 0.2\n'


pytestmark = pytest.mark.usefixtures("handlers_and_collector_stay")


def fly_by_law(endpoint: udp.Endpoint, *_: object) -> None:
    """Carry datagrams between the vehicle and a law on a virtual clock."""
    law, now_us = ControllerEndpoint(load_law("hinf-d1"), VEHICLE), 0
    while not endpoint.finished:
        for datagram, _ in law.poll(now_us):
            endpoint.receive(datagram, CONTROLLER, now_us)
        for datagram, _ in endpoint.poll(now_us):
            law.receive(datagram, VEHICLE, now_us)
        now_us += 1_000


def interrupt(endpoint: udp.Endpoint, *_: object, **__: object) -> None:
    """Do as Ctrl-C does right after the start."""
    endpoint.poll(0)
    signal.raise_signal(signal.SIGINT)
    assert endpoint.finished


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--scenario", "nowhere"], "no scenario named 'nowhere'"),
        (["--vehicle", "missing.toml"], "missing.toml"),
        (["--journal", "no/such/folder/flight"], "no/such/folder/flight"),
        (["--tlog", "no/such/folder/flight.tlog"], "no/such/folder/flight.tlog"),
        (["--bind-port", "70000"], "70000"),
        (["--instance", "300"], "--instance is 300, must be 0 to 253"),
        (["--instance", "-1"], "--instance is -1, must be 0 to 253"),
        (["--seed", "-1"], "--seed is -1, must be 0 to 4294967295"),
        (["--scenario", "calm", "--held"], "--held and --air need a vehicle without --scenario and --lockstep"),
        (["--lockstep", "--air", "calm"], "--held and --air need a vehicle without --scenario and --lockstep"),
    ],
)
def test_bad_input_is_told_in_one_line(arguments, words, capsys):
    assert command.main(["--bind-port", "0", *arguments]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert len(error.splitlines()) == 1


def test_port_in_use_is_told_in_one_line(capsys):
    with udp.bind(0) as taken:
        assert command.main(["--json", "--bind-port", str(taken.getsockname()[1])]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert "Address already in use: end the other autopilot or real-time flight" in told.err
    assert len(told.err.splitlines()) == 1


@pytest.mark.parametrize("dialect", ["px4", "generic"])
def test_all_parameters_are_printed_and_nothing_starts(dialect, capsys):
    table = Parameters(load_vehicle("paper"), load_scenario("calm"), bytewise=dialect == "px4").table
    assert command.main(["--params", "--autopilot", dialect]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == [each.name for each in table]
    assert command.main(["--params", "--json", "--autopilot", dialect]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [row["name"] for row in rows] == [each.name for each in table]
    assert all({"type", "default", "unit", "allowed", "meaning"} <= row.keys() for row in rows)


@pytest.mark.parametrize("logged", [False, True])
def test_a_flight_in_lockstep_ends_with_its_facts_and_its_journal(logged, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(udp, "serve_lockstep", fly_by_law)
    (tmp_path / "short.toml").write_text(SCENARIO, encoding="utf-8")
    journal, log = tmp_path / "flight.journal", tmp_path / "flight.tlog"
    options = ["--scenario", str(tmp_path / "short.toml"), "--lockstep", "--bind-port", "0", "--seed", "3"]
    assert command.main(["--json", "--journal", str(journal), *options, *(["--tlog", str(log)] * logged)]) == 0
    greeting, facts = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert (greeting["scenario"], greeting["vehicle"], greeting["seed"]) == ("short", "paper", 3)
    assert (facts["outcome"], facts["samples"], facts["of"]) == ("done", 50, 50)
    assert (facts["pace"], facts["counters"], facts["link_faults"]) == (None, {}, {})
    header, records = read_journal(journal)
    assert header["note"]["law"] is None
    assert header["note"]["real_time"] is False
    direct = fly_direct(
        load_scenario(tmp_path / "short.toml"), load_law("hinf-d1"), vehicle=load_vehicle("paper"), seed=3
    )
    assert records.tobytes() == direct.tobytes()
    assert log.exists() is logged


def test_a_standing_vehicle_says_how_to_connect_and_its_end(monkeypatch, capsys):
    monkeypatch.setattr(udp, "serve", interrupt)
    assert command.main(["--bind-port", "0", "--held", "--air", "shear"]) == 130
    greeting, *_, end = capsys.readouterr().out.split("Ctrl-C ends it.\n")
    assert greeting.startswith("vehicle 'paper' on the test stand in the air of 'shear', disarmed")
    assert "interrupted" in end


def test_an_instance_has_its_own_ports_and_sends_where_its_peers_look(monkeypatch, capsys):
    served = []
    monkeypatch.setattr(udp, "serve", lambda endpoint, sockets, **_: served.append(endpoint) or endpoint.interrupt())
    assert command.main(["--json", "--instance", "253"]) == 130
    greeting, facts = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert greeting["listening"] == [18570 + 253, 14580 + 253]
    assert served[0].system == 254
    assert (facts["outcome"], facts["of"]) == ("interrupted", None)
    assert set(facts["links"]) == {"127.0.0.1:14803", "127.0.0.1:14793"}
