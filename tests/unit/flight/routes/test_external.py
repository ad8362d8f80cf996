"""A flight of a stand-in for PX4, from the command that starts it to the report."""

import json
import subprocess
import sys
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from gustproof.errors import FlightError
from gustproof.flight.controllers.external_autopilot import ExternalAutopilot
from gustproof.flight.recording.bag import read_bag, read_estimate_topics
from gustproof.flight.routes import external
from gustproof.flight.routes.external import check_external, describe_rate, fly_external
from gustproof.flight.routes.flight import Flight, FlightPlan, parse_plan
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.flight.routes.recorder import fly_and_record, recover
from gustproof.flight.scoring.estimator_view import compare_estimates
from gustproof.law.form import load_law
from gustproof.show.report.html.page import render_page
from gustproof.show.report.html.runs import read_runs
from gustproof.studies.campaign.comparison import compare

PEER = Path(__file__).parents[2] / "firmware_model" / "external" / "px4_build"
SCENARIO = replace(load_scenario("paper-turbulence"), duration_s=2.0)
AUTOPILOT = ExternalAutopilot(kind="px4", build=str(PEER), parameters="tuned")
PLAN = FlightPlan(SCENARIO, AUTOPILOT, load_vehicle("paper"), 3, real_time=False)


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    return fly_and_record(PLAN, tmp_path_factory.mktemp("flight"), tlog=True)


def test_flight_leaves_its_bag_with_plan_and_facts(flight: Flight) -> None:
    assert flight.outcome is FlightOutcome.DONE
    # The peer knows each parameter but one of the shipped set.
    assert flight.warnings == ("PX4 has no parameter MC_YAW_P, and ignored it",)
    assert flight.bag is not None
    assert flight.bag.name == "paper-turbulence-px4-tuned-seed3"
    about, records = read_bag(flight.bag)
    assert len(records) == 500
    assert about["law"] is None
    assert about["autopilot"]["flown"]["version"] == "1.16.0 (cdef01)"
    assert about["autopilot"]["flown"]["parameters"]["MC_ROLLRATE_P"] == "0.2"
    assert parse_plan(about, flight.bag) == PLAN
    kept = flight.bag.with_suffix(".autopilot") / "px4-rc.params"
    assert "param set CA_ROTOR0_PX 0.22" in kept.read_text().splitlines()
    assert flight.bag.with_suffix(".tlog").exists()
    assert not list(flight.bag.parent.glob("*.attitude"))


def test_own_attitude_is_told_in_topics_and_figures(flight: Flight) -> None:
    assert flight.bag is not None
    assert flight.estimates is not None
    assert flight.estimator_view is not None
    assert flight.metrics is not None
    assert read_estimate_topics(flight.bag).tobytes() == flight.estimates.tobytes()
    # The peer takes the truth every fifth sample, and is as good as its gyro between.
    assert flight.estimator_view.estimate_rmse_deg < 0.05
    assert flight.estimator_view.true_control_rmse_deg == pytest.approx(flight.metrics.rmse_deg, rel=0.1)
    document = json.loads(json.dumps(flight.to_dict()))
    assert document["own_view"]["control_rmse_deg"] == flight.estimator_view.control_rmse_deg


def test_page_names_autopilot_and_its_view(flight: Flight) -> None:
    assert flight.bag is not None
    page = render_page(read_runs([flight.bag]))
    assert "PX4 1.16.0 (cdef01)" in page
    assert "as the autopilot sees it" in page


def test_comparison_puts_law_and_autopilot_side_by_side() -> None:
    law = load_law("flagship")
    theirs, ours = compare([SCENARIO], PLAN.vehicle, {"px4-tuned": AUTOPILOT, "flagship": law}, [1])
    assert (theirs.name, ours.name) == ("px4-tuned", "flagship")
    assert (ours.own_rmse_deg, ours.realtime_factor) == (None, None)
    assert theirs.own_rmse_deg is not None
    assert theirs.own_rmse_deg > 0.0
    assert theirs.steady_rmse_deg <= theirs.rmse_deg


def test_flight_that_did_not_begin_can_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PEER_FAULT", "no lockstep")
    bags: list[bool] = []
    flight = fly_and_record(PLAN, tmp_path, on_flown=lambda: bags.append(any(tmp_path.glob("**/*.mcap"))))
    assert bags == [False]
    assert flight.outcome is FlightOutcome.WRONG_BUILD
    assert "without lockstep" in flight.message
    assert flight.bag is not None
    about, records = read_bag(flight.bag)
    assert (about["outcome"], len(records)) == ("wrong_build", 1)
    with pytest.raises(FlightError, match="without lockstep"):
        compare([SCENARIO], PLAN.vehicle, {AUTOPILOT.name: AUTOPILOT}, [1])


def test_comparison_that_is_interrupted_ends_as_such(flight: Flight, monkeypatch: pytest.MonkeyPatch) -> None:
    interrupted = replace(flight, outcome=FlightOutcome.INTERRUPTED)
    monkeypatch.setattr("gustproof.flight.routes.controllers.fly_external", lambda *_, **__: interrupted)
    with pytest.raises(KeyboardInterrupt):
        compare([SCENARIO], PLAN.vehicle, {AUTOPILOT.name: AUTOPILOT}, [1])


@pytest.mark.slow
def test_cut_off_flight_is_recovered_with_its_attitude(tmp_path: Path) -> None:
    flown = fly_external(PLAN, tmp_path)
    (recovered,) = recover(tmp_path)
    assert recovered.pilot_name == "px4-tuned"
    assert recovered.records.tobytes() == flown.records.tobytes()
    assert recovered.bag is not None
    assert flown.estimates is not None
    assert len(read_estimate_topics(recovered.bag)) == len(flown.estimates)


@pytest.mark.parametrize(
    ("name", "free", "why"), [("controller-crash", False, "link, controller or modes"), ("large-step", True, "tilt")]
)
def test_scenario_that_only_our_autopilot_flies_is_refused(name: str, free: bool, why: str) -> None:
    script = load_scenario(name)
    if free:
        script = replace(script, translation="free", initial_attitude_deg=(10.0, 0.0, 0.0))
    with pytest.raises(ConfigError, match=why):
        check_external(script, "px4")


@pytest.mark.parametrize(("kind", "rate_hz", "refused"), [
    ("px4", 250, False), ("px4", 1000, True), ("px4", 400, True), ("px4", 100, True),
    ("ardupilot", 250, False), ("ardupilot", 400, False), ("ardupilot", 1000, True), ("betaflight", 400, True),
])  # fmt: skip
def test_scenario_that_asks_for_another_rate_is_refused(kind: str, rate_hz: int, refused: bool) -> None:
    script = replace(load_scenario("calm"), control_rate_hz=rate_hz, physics_rate_hz=2000)
    with pytest.raises(ConfigError, match=f"asks for {rate_hz} samples") if refused else nullcontext():
        check_external(script, kind)


def test_default_rate_is_no_request_but_the_autopilots_own_is_told() -> None:
    assert describe_rate(SCENARIO, "px4") == ""
    assert describe_rate(replace(SCENARIO, control_rate_hz=1000), "px4") == ""  # it is refused
    assert "ardupilot takes 400 samples a second" in describe_rate(SCENARIO, "ardupilot")


@pytest.mark.parametrize(("writes", "outcome"), [(False, FlightOutcome.HUNG), (True, FlightOutcome.KILLED)])
def test_a_simulator_that_records_nothing_more_is_ended_and_its_flight_has_hung(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writes: bool, outcome: FlightOutcome
) -> None:
    """One that writes records now and then, and then ends, has not hung."""
    does = "[f.write(bytes(999)) and f.flush() or time.sleep(.1) for _ in range(12)]" if writes else "time.sleep(60)"

    def launch(_: str, *arguments: str) -> "subprocess.Popen[str]":
        journal = arguments[arguments.index("--journal") + 1]
        Path(journal).write_bytes(b"{}\n")
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        script = f"import time; print(1, flush=True); f = open({journal!r}, 'ab'); {does}"
        return subprocess.Popen([sys.executable, "-c", script], text=True, **pipes)

    monkeypatch.setattr(external, "launch", launch)
    monkeypatch.setattr(external, "_STILL_S", 0.5)
    monkeypatch.setattr(external, "read_journal", lambda _: ({}, np.empty(0)))
    flight = fly_external(PLAN, tmp_path)
    assert flight.outcome is outcome
    assert ("recorded nothing for 0.5 s" in flight.message) == (outcome is FlightOutcome.HUNG)


def test_build_that_is_not_there_is_bad_input(tmp_path: Path) -> None:
    plan = PLAN._replace(controller=replace(AUTOPILOT, build=str(tmp_path)))
    with pytest.raises(ConfigError, match="no PX4 built for simulation"):
        fly_external(plan, tmp_path / "out")


def test_unknown_autopilot_is_bad_input() -> None:
    with pytest.raises(ConfigError, match="'inav' is none of px4, ardupilot"):
        ExternalAutopilot(kind="inav")


def test_errors_are_those_of_turned_attitudes(flight: Flight) -> None:
    records = flight.records[:100].copy()
    records["q_NB"] = (1.0, 0.0, 0.0, 0.0)
    half = np.radians(0.5)
    told = np.zeros(20, dtype=(flight.estimates if flight.estimates is not None else records).dtype)
    told["time_us"], told["q_NB"], told["setpoint_q_NB"] = (
        records["time_us"][::5],
        (np.cos(half), np.sin(half), 0, 0),
        0,
    )
    told["setpoint_q_NB"][:, 0] = 1.0
    view = compare_estimates(records, told)
    assert view is not None
    assert view.estimate_axes_deg == pytest.approx((1.0, 0.0, 0.0))
    assert view.control_rmse_deg == pytest.approx(1.0 / np.sqrt(3.0))
    assert view.estimate_steady_deg == pytest.approx(0.0, abs=1e-9)
    assert view.true_control_rmse_deg == 0.0
