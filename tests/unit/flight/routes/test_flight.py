"""A flight's plan survives its recording, and journals of cut-off flights become recordings."""

import errno
import json
import math
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from firmware_model.autopilot.modes import Mode
from firmware_model.config.events import ModeChange, Payload
from firmware_model.config.link_faults import Jitter, LinkDelay
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from firmware_model.recording.journal import RECORD, WIDTH, JournalWriter, record_blocks
from gustproof.errors import FlightError
from gustproof.flight.recording.bag import read_bag, write_bag
from gustproof.flight.recording.folder import find_bags
from gustproof.flight.routes import recorder
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.flight import (
    Flight,
    FlightPlan,
    check,
    first_difference_s,
    parse_plan,
    warnings,
)
from gustproof.flight.routes.outcome import FlightOutcome, describe, infer_outcome
from gustproof.flight.routes.processes import fly_plan, terminate
from gustproof.flight.routes.recorder import recover
from gustproof.flight.routes.upsets import describe_upsets, divergence_s
from gustproof.law.form import list_laws, load_law

PAPER, IRIS = load_vehicle("paper"), load_vehicle("iris")
SHORT = replace(load_scenario("paper"), duration_s=2.0)
PLAN = FlightPlan(SHORT, load_law("hinf-d1"), load_vehicle("iris"), 7, False)
NAME = "paper-hinf-d1-seed7"
DROP = Payload(kind="payload", at_s=5.0, mass_kg=-3.0, inertia_kgm2=(-0.045, -0.045, -0.045))
HOLD = (ModeChange(kind="mode", at_s=1.0, mode="hold"),)


@pytest.fixture(scope="module")
def records():
    flown = fly_direct(SHORT, PLAN.controller, vehicle=PLAN.vehicle, seed=7).copy()
    flown["mode"] = 6 << 16
    return flown


def write_journal(folder, records, header=None):
    header = {"note": json.loads(json.dumps(PLAN.metadata()))} if header is None else header
    with JournalWriter(folder / f"{NAME}.journal", header) as journal:
        for row in records.copy().view(np.float64).reshape(len(records), WIDTH):
            journal.append(row)


def test_a_plan_goes_through_json_and_back_without_a_bit_lost():
    back = parse_plan(json.loads(json.dumps(PLAN.metadata())), "here")
    assert (back.scenario, back.vehicle, back.seed, back.real_time) == (SHORT, PLAN.vehicle, 7, False)
    assert back.controller.to_dict() == PLAN.controller.to_dict()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"seed": None}, "does not say what was flown"),
        ({"law": "hinf-d1"}, "does not say what was flown"),
        ({"law": {"name": "x"}}, "law: format: must be"),
        ({"scenario": {"name": "x"}}, "scenario: description: missing"),
    ],
)
def test_a_note_that_says_too_little_is_refused_in_one_line(change, words):
    with pytest.raises(ConfigError, match=f"^here: {words}"):
        parse_plan({**PLAN.metadata(), **change}, "here")


def test_a_flight_that_was_whole_gives_the_bag_that_it_would_have_left(tmp_path, records):
    write_journal(tmp_path, records)
    (recovered,) = recover(tmp_path)
    assert recovered.outcome is FlightOutcome.DONE
    about, judged = {**PLAN.metadata(), "outcome": "done"}, [result.to_dict() for result in recovered.requirements]
    write_bag(tmp_path / "undisturbed" / NAME, records, about, requirements=judged)
    ours, theirs = (folder / NAME / f"{NAME}.mcap" for folder in (tmp_path, tmp_path / "undisturbed"))
    assert ours.read_bytes() == theirs.read_bytes()


def test_what_a_lost_disk_cache_leaves_is_cut_off_and_leftovers_are_removed(tmp_path, records):
    spoiled = records.copy()
    spoiled[300:] = np.zeros(1, dtype=records.dtype)
    write_journal(tmp_path, spoiled)
    for leftover in (".bag-killed", ".flight-killed"):
        (tmp_path / leftover / NAME).mkdir(parents=True)
    (recovered,) = recover(tmp_path)
    assert recovered.outcome is FlightOutcome.CUT_OFF
    assert recovered.message.endswith("300 of 500 samples")
    about, back = read_bag(tmp_path / NAME)
    assert about["outcome"] == "cut_off"
    assert back.tobytes() == records[:300].tobytes()
    assert [path.name for path in tmp_path.iterdir()] == [NAME]


def test_a_flight_whose_modes_the_script_changed_is_recovered_as_what_it_was(tmp_path, records):
    plan = PLAN._replace(scenario=replace(SHORT, event=HOLD))
    held = records.copy()
    held["mode"][250:] = Mode.HOLD.value
    write_journal(tmp_path, held, {"note": json.loads(json.dumps(plan.metadata()))})
    (recovered,) = recover(tmp_path)
    assert (recovered.outcome, recovered.has_expected_outcome) == (FlightOutcome.LEFT_OFFBOARD, True)
    assert recovered.message.endswith("flown as scripted: HOLD from 1 s, 500 of 500 samples")
    assert read_bag(tmp_path / NAME)[0]["outcome"] == "left_offboard"


def test_laws_without_a_reference_input_are_warned_of_where_the_script_gives_references():
    steps = load_scenario("attitude-steps")
    deaf = {name for name in list_laws() if warnings(steps, load_law(name), PAPER)}
    assert {"hinf-d1", "hinf-d1-noise", "hinf-d2", "hinf-scheduled", "hinf-rates"} <= deaf
    assert deaf.isdisjoint({"hinf-reference", "pid-default", "pid-fair"})
    (line,) = warnings(steps, load_law("hinf-d1"), PAPER)
    assert line == "law 'hinf-d1' has no reference input: it ignores the attitude references of 'attitude-steps'"
    assert warnings(SHORT, load_law("hinf-d1"), PAPER) == ()


def test_check_takes_every_shipped_law_on_its_own_vehicle():
    for name in list_laws():
        law = load_law(name)
        check(SHORT, law, load_vehicle(law.provenance.vehicle))
        assert warnings(SHORT, law, PAPER) == ()


def test_check_refuses_a_law_that_is_unstable_on_the_vehicle():
    unstable = "law 'pid-fair' is unstable on vehicle 'iris', by the linear model at hover"
    with pytest.raises(ConfigError, match=f"^{unstable}, and designed for 'paper'; --anyway flies it all the same$"):
        check(SHORT, load_law("pid-fair"), IRIS)
    other = "law 'pid-fair' was designed for vehicle 'paper', not 'iris'"
    assert warnings(SHORT, load_law("pid-fair"), IRIS) == (unstable, other)


@pytest.mark.parametrize("name", ["my-twin", "paper"])
def test_a_law_of_a_shipped_vehicle_is_for_its_numbers_whatever_the_name(name):
    copy = replace(PAPER, name=name, source="mine", description="mine", rate_damping=PAPER.rate_damping_B)
    law = load_law("pid-fair")
    assert warnings(SHORT, law, copy) == ()
    assert warnings(SHORT, law, replace(copy, mass=11.0), copy) == ()  # a campaign's sample
    told = "not 'my-twin'" if name == "my-twin" else "but of other numbers"
    doubt = (f"law 'pid-fair' was designed for vehicle 'paper', {told}",)
    for other in (
        {"mass": 1.01 * copy.mass},
        {"inertia_B": (0.25, 0.2, 0.13)},
        {"rotors": load_vehicle("octo").rotors},
    ):
        assert warnings(SHORT, law, replace(copy, **other)) == doubt


def test_another_vehicles_law_is_named_where_it_is_stable():
    for name in ("pid-default", "hinf-rates"):
        check(SHORT, load_law(name), IRIS)
        assert warnings(SHORT, load_law(name), IRIS) == (f"law '{name}' was designed for vehicle 'paper', not 'iris'",)


def test_check_names_payload_and_mass_that_do_not_fit():
    dropping = "event 'payload' at 5.0 s: vehicle 'iris' of 1.5 kg can't be with -3 kg: mass"
    with pytest.raises(ConfigError, match=f"^{dropping}"):
        check(replace(SHORT, event=(DROP,)), load_law("pid-default"), IRIS)


def test_check_refuses_a_body_that_can_not_be_before_and_after_a_payload():
    flat = replace(PAPER, inertia_B=(0.02, 0.02, 0.4))
    with pytest.raises(ConfigError, match=r"^vehicle 'paper': inertia_B: no rigid body has 0\.02 about x"):
        check(SHORT, load_law("pid-fair"), flat)
    lost = Payload(kind="payload", at_s=1.0, inertia_kgm2=(0.0, -0.1, 0.0))
    after = r"^scenario 'paper': vehicle 'paper' from 1 s on: inertia_B: no rigid body has 0\.25 about x"
    with pytest.raises(ConfigError, match=after):
        check(replace(SHORT, event=(lost,)), load_law("pid-fair"), PAPER)


@pytest.mark.slow
@pytest.mark.parametrize(("missed", "event", "warned"), [(3, (), True), (0, (), False), (3, HOLD, False)])
def test_samples_that_never_came_are_warned_of_unless_the_script_is_of_such(records, missed, event, warned):
    flown = Flight(
        scenario=replace(SHORT, event=event), controller=PLAN.controller, vehicle=PLAN.vehicle, seed=7,
        outcome=FlightOutcome.DONE, message="", records=records, timing={"missed_samples": missed},
    )  # fmt: skip
    assert any("3 samples never came to law 'hinf-d1'" in line for line in flown.to_dict()["warnings"]) is warned


def test_a_journal_without_one_record_leaves_nothing(tmp_path, records):
    write_journal(tmp_path, records[:0])
    (recovered,) = recover(tmp_path)
    assert (recovered.bag, recovered.metrics) == (None, None)
    assert list(tmp_path.iterdir()) == []


def test_a_bag_that_is_there_already_is_kept_and_its_journal_removed(tmp_path, records):
    write_journal(tmp_path, records)
    write_bag(tmp_path / NAME, records, {**PLAN.metadata(), "outcome": "interrupted"})
    recover(tmp_path)
    assert read_bag(tmp_path / NAME)[0]["outcome"] == "interrupted"
    assert [path.name for path in tmp_path.iterdir()] == [NAME]


def test_another_flight_s_bag_is_never_overwritten(tmp_path, records):
    write_journal(tmp_path, records)
    write_bag(tmp_path / NAME, records[:100], {**PLAN.metadata(), "outcome": "interrupted"})
    with pytest.raises(ConfigError, match="never overwritten"):
        recover(tmp_path)
    assert (tmp_path / f"{NAME}.journal").exists()


def test_a_flight_that_goes_on_is_not_recovered(tmp_path):
    (tmp_path / ".flight-on").mkdir()
    with JournalWriter(tmp_path / f"{NAME}.journal", {}), pytest.raises(ConfigError, match="the flight is not over"):
        recover(tmp_path)
    assert (tmp_path / ".flight-on").exists()


def test_a_folder_without_a_journal_and_a_journal_without_a_note_are_refused(tmp_path, records):
    with pytest.raises(ConfigError, match="nothing to recover"):
        recover(tmp_path)
    write_journal(tmp_path, records, header={"scenario": "paper"})
    with pytest.raises(ConfigError, match="does not say what was flown"):
        recover(tmp_path)
    with pytest.raises(ConfigError, match=f"a journal is: gustproof report {tmp_path} completes it$"):
        find_bags(tmp_path)


def test_no_room_for_the_bag_keeps_the_journal_and_says_what_to_do(tmp_path, records, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    write_journal(tmp_path, records)
    monkeypatch.setattr(recorder, "write_bag", full)
    with pytest.raises(FlightError, match=r"No space left on device; what was flown is in .*then gustproof report"):
        recover(tmp_path)
    assert (tmp_path / f"{NAME}.journal").exists()


def test_a_flight_without_a_sample_leaves_no_file(tmp_path):
    """An empty log of the traffic kept the next flight out of the folder."""
    write_journal(tmp_path, np.empty(0, dtype=RECORD))
    (tmp_path / f"{NAME}.tlog").touch()
    (found,) = recover(tmp_path)
    assert found.bag is None
    assert not list(tmp_path.iterdir())


def test_a_process_that_hears_no_signal_ends_in_time():
    deaf = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print(1, flush=True); time.sleep(60)"
    with subprocess.Popen([sys.executable, "-c", deaf], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "1\n"
        begun = time.monotonic()
        terminate(process, 0.1)
        assert time.monotonic() - begun < 3.0
    assert process.returncode == -signal.SIGKILL


def test_no_room_for_what_the_processes_read_names_the_folder(tmp_path, monkeypatch):
    """It was told of standard output."""

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(OSError, match="No space left") as caught:
        fly_plan(FlightPlan(load_scenario("gust-roll"), load_law("hinf-d1"), load_vehicle("paper"), 1, False), tmp_path)
    assert caught.value.filename == str(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("size", [1, 249, 500])
@pytest.mark.parametrize("script", ["attitude-steps", "gust-roll", "kick", "paper"])
def test_a_flight_in_blocks_has_the_figures_of_one_block(monkeypatch, script, size):
    scenario = load_scenario(script)
    weak = replace(PAPER, gyro=replace(PAPER.gyro, range=0.5))
    flown = fly_direct(scenario, PLAN.controller, vehicle=weak)[:8000].copy()
    flown["mode"] = 6 << 16
    flown["mode"][[248, 249, 500, 700]] = 4 << 16
    told = []
    for block in (len(flown), size):
        monkeypatch.setattr(record_blocks, "__defaults__", (block,))
        flight = Flight(
            scenario=scenario,
            controller=PLAN.controller,
            vehicle=weak,
            seed=7,
            records=flown,
            outcome=FlightOutcome.DONE,
            message="",
        )
        outcome = infer_outcome(flown, scenario)
        told.append((flight.to_dict(), outcome, describe(outcome, scenario, flown)))
    assert told[0] == told[1]
    assert (told[0][0]["requirements"] != []) == bool(scenario.require)


@pytest.mark.parametrize("cut", [0, 6, 7, 40])
def test_upsets_are_found_in_any_block(monkeypatch, records, cut):
    spoilt = records.copy()
    spoilt["q_NB"][cut:] = (0.0, 1.0, 0.0, 0.0)
    spoilt["gyro_B"][cut : cut + 3] = 1e3
    monkeypatch.setattr(record_blocks, "__defaults__", (7,))
    lines = describe_upsets(spoilt, SHORT, PLAN.vehicle)
    assert lines == (f"tilted past 90 deg at {cut * SHORT.dt:.1f} s", f"gyro at its range for {3 * SHORT.dt:.3g} s")
    spoilt["omega_B"][cut] = np.inf
    assert divergence_s(spoilt, SHORT) == pytest.approx(cut * SHORT.dt)


def test_the_first_bit_that_differs_is_found_and_a_shorter_flight_is_no_difference(monkeypatch, records):
    other = records.copy()
    assert first_difference_s(records, other) is None
    assert first_difference_s(records, other[:20]) is None
    assert first_difference_s(records, other[:0]) is None
    other["gyro_B"][33, 1] = np.nextafter(other["gyro_B"][33, 1], 1.0)
    for size in (1, 33, 34, 1000):
        monkeypatch.setattr(record_blocks, "__defaults__", (size,))
        assert first_difference_s(records, other) == pytest.approx(33 * 0.004)
        assert first_difference_s(records, other[:33]) is None


def link(kind: str, **table) -> tuple:
    made = {"delay": LinkDelay, "jitter": Jitter}[kind]
    return (made(kind=kind, direction="to_vehicle", **table),)


def test_constant_delay_of_the_link_is_refused_as_that_of_the_commands_is():
    flagship = load_law("flagship")
    delayed = replace(SHORT, link=link("delay", delay_s=0.04))
    with pytest.raises(ConfigError, match=r"unstable on vehicle 'paper' with 40 ms of link delay, .*--anyway"):
        check(delayed, flagship, PAPER)
    assert len(warnings(delayed, flagship, PAPER)) == 1
    check(replace(SHORT, link=link("delay", delay_s=0.008)), flagship, PAPER)


@pytest.mark.parametrize(
    "table",
    [link("jitter", most_s=0.06), link("delay", delay_s=0.06, start_s=0.5), link("delay", delay_s=0.06, stop_s=1.0)],
)
def test_jitter_and_passing_delays_are_warned_of(table):
    flagship, late = load_law("flagship"), replace(SHORT, link=table)
    check(late, flagship, PAPER)
    line = "law 'flagship' is unstable while the link is late by 60 ms, by the linear model at hover"
    assert warnings(late, flagship, PAPER) == (line,)
    assert warnings(late, load_law("hinf-rates"), PAPER) == ()


def test_upsets_of_a_flight_are_among_its_warnings(records):
    turned = records.copy()
    turned["q_NB"][250] = 0.0, 1.0, 0.0, 0.0
    for law in (PLAN.controller, None):
        flight = Flight(
            scenario=SHORT, controller=law, vehicle=PLAN.vehicle, seed=7, records=turned,
            outcome=FlightOutcome.DONE, message="",
        )  # fmt: skip
        assert flight.warnings[-1] == "tilted past 90 deg at 1.0 s"
        assert flight.to_dict()["warnings"] == list(flight.warnings)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_reference_that_is_not_finite_is_refused_with_its_sample(bad: float) -> None:
    scenario = replace(load_scenario("calm"), duration_s=0.4)
    reference = np.zeros((scenario.samples, 3))
    reference[7, 1] = bad
    with pytest.raises(ValueError, match="not finite from sample 7 on"):
        fly_direct(scenario, load_law("flagship"), vehicle=load_vehicle("paper"), reference=reference)
