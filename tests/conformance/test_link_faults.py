"""Link faults and events of the controller: lockstep, UDP, and real time on a virtual clock fly the same bits."""

import random
from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest

from firmware_model.autopilot.modes import Mode
from firmware_model.autopilot.parameters import published_limit
from firmware_model.config.events import ControllerHang, ControllerKill, ModeChange
from firmware_model.config.link_faults import Bandwidth, BurstLoss, Duplication, Jitter, LinkDelay, Loss, Reordering
from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.numerics.rotations import euler_angles
from firmware_model.session.outcome import VehicleOutcome as VehicleOutcome
from firmware_model.session.pacing import TimingFault
from firmware_model.session.vehicle_endpoint import VehicleEndpoint
from gustproof.flight.endpoint.endpoint import ControllerEndpoint
from gustproof.flight.routes.direct import NeedsMessages, fly_direct
from gustproof.flight.routes.loopback import fly_loopback
from gustproof.flight.routes.outcome import FlightOutcome, describe, infer_outcome
from gustproof.flight.routes.processes import fly
from gustproof.law.form import load_law
from gustproof.law.step import LawStepper

VEHICLE = load_vehicle("paper")
GUSTY = replace(load_scenario("paper-turbulence"), duration_s=4.0)
SAMPLE_S = GUSTY.dt
UP, DOWN = {"direction": "to_vehicle"}, {"direction": "to_controller"}
OFFBOARD, STABILIZED, HOLD = Mode.OFFBOARD, Mode.STABILIZED, Mode.HOLD

FOUL = (
    LinkDelay(kind="delay", delay_s=0.003, **DOWN),
    Jitter(kind="jitter", most_s=0.008, **UP),
    Jitter(kind="jitter", most_s=0.002, **DOWN),
    BurstLoss(kind="burst_loss", to_bad=0.02, to_good=0.2, **UP),
    Loss(kind="loss", probability=0.05, **DOWN),
    Duplication(kind="duplication", probability=0.1, **DOWN),
    Duplication(kind="duplication", probability=0.1, **UP),
    Reordering(kind="reordering", probability=0.05, by_s=0.01, **DOWN),
    Reordering(kind="reordering", probability=0.05, by_s=0.01, **UP),
    Bandwidth(kind="bandwidth", rate_bit_s=120_000.0, start_s=1.0, stop_s=1.5, **DOWN),
)
KILLED_FOR_LONG = ControllerKill(kind="controller_killed", at_s=0.5, recovers_after_s=1.8)
KILLED_FOR_A_MOMENT = ControllerKill(kind="controller_killed", at_s=0.5, recovers_after_s=0.1)
SCRIPTS = {
    "foul, hung, modes": replace(
        GUSTY,
        link=FOUL,
        event=(
            ControllerHang(kind="controller_hung", at_s=0.5, for_s=0.1),
            ModeChange(kind="mode", at_s=1.6, mode="hold"),
            ModeChange(kind="mode", at_s=2.0, mode="offboard"),
        ),
    ),
    "killed for long": replace(GUSTY, event=(KILLED_FOR_LONG,)),
    "killed for a moment": replace(GUSTY, event=(KILLED_FOR_A_MOMENT,)),
}


def loopback(scenario: Scenario, law: str = "hinf-scheduled", seed: int = 7) -> np.ndarray:
    return fly_loopback(scenario, load_law(law), vehicle=VEHICLE, seed=seed)


def phases(records: np.ndarray) -> list[tuple[Mode, float]]:
    """Return each flown mode with its start [s]."""
    begun = [next(group) for _, group in groupby(enumerate(records["mode"]), key=lambda item: item[1])]
    return [(Mode(int(mode)), round(sample * SAMPLE_S, 3)) for sample, mode in begun]


class RealTime:
    """A flight in real time, on a virtual clock that serves both sides to the microsecond."""

    def __init__(self, scenario: Scenario, seed: int = 7) -> None:
        self.rows: list[bytes] = []
        self.vehicle = VehicleEndpoint(
            VEHICLE, scenario, seed, lambda row: self.rows.append(row.tobytes()), lockstep=False
        )
        controller, now_us = ControllerEndpoint(load_law("hinf-scheduled"), (0, ("vehicle", 1))), 0
        while not self.vehicle.finished:
            sent = self.vehicle.poll(now_us)
            for datagram, _ in sent:
                controller.receive(datagram, (0, ("vehicle", 1)), now_us)
            answers = controller.poll(now_us)
            for datagram, _ in answers:
                self.vehicle.receive(datagram, (0, ("controller", 1)), now_us)
            if not sent and not answers:
                now_us = max(now_us + 1, min(self.vehicle.deadline_us(), controller.deadline_us()))


def delayed(scenario: Scenario, down: int, up: int) -> Scenario:
    """Return the scenario over a link that delays both directions by whole samples."""
    link = [
        LinkDelay(kind="delay", delay_s=samples * SAMPLE_S, **way)
        for samples, way in ((down, DOWN), (up, UP))
        if samples
    ]
    return replace(scenario, link=tuple(link))


@pytest.mark.parametrize("law", ["hinf-scheduled", "hinf-rates"])
@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize(("down", "up"), [(0, 1), (1, 0), (3, 0), (1, 2)])
def test_delay_of_n_samples_is_n_delay_samples_more(law, delay, down, up):
    scenario = replace(GUSTY, duration_s=2.0, delay_samples=delay)
    later = replace(scenario, delay_samples=delay + down + up)
    direct = fly_direct(later, load_law(law), vehicle=VEHICLE, seed=7)
    assert loopback(delayed(scenario, down, up), law).tobytes() == direct.tobytes()


def test_delay_of_n_samples_is_n_delay_samples_more_in_real_time():
    scenario = replace(GUSTY, duration_s=2.0)
    direct = fly_direct(replace(scenario, delay_samples=4), load_law("hinf-scheduled"), vehicle=VEHICLE, seed=7)
    assert b"".join(RealTime(delayed(scenario, 1, 2)).rows) == direct.tobytes()


def test_delay_of_n_samples_is_n_delay_samples_more_between_two_processes(tmp_path):
    law = load_law("hinf-scheduled")
    direct = fly_direct(replace(GUSTY, delay_samples=4), law, vehicle=VEHICLE, seed=7)
    flight = fly(delayed(GUSTY, 1, 2), law, vehicle=VEHICLE, seed=7, out=tmp_path)
    assert flight.records.tobytes() == direct.tobytes()
    assert (flight.outcome, flight.counters["held"]) == (FlightOutcome.DONE, 3)
    # The last datagrams arrive after the end.
    assert flight.link["to_controller"] == {"sent": GUSTY.samples, "arrived": GUSTY.samples - 1}
    assert flight.link["to_vehicle"] == {"sent": GUSTY.samples - 1, "arrived": GUSTY.samples - 3}


def test_delay_shorter_than_a_sample_is_within_the_one_that_a_command_has():
    scenario = replace(GUSTY, duration_s=2.0)
    link = (LinkDelay(kind="delay", delay_s=0.001, **DOWN), LinkDelay(kind="delay", delay_s=0.002, **UP))
    assert loopback(replace(scenario, link=link)).tobytes() == loopback(scenario).tobytes()
    # 1 + 3 ms is a whole sample, though neither is.
    link = (link[0], LinkDelay(kind="delay", delay_s=0.003, **UP))
    assert loopback(replace(scenario, link=link)).tobytes() == loopback(replace(scenario, delay_samples=2)).tobytes()


@pytest.mark.parametrize("script", SCRIPTS)
def test_two_processes_equal_loopback_to_the_bit(script, tmp_path):
    flight = fly(SCRIPTS[script], load_law("hinf-scheduled"), vehicle=VEHICLE, seed=7, out=tmp_path)
    looped = loopback(SCRIPTS[script])
    assert len(looped) == GUSTY.samples
    assert flight.records.tobytes() == looped.tobytes()
    expected = {
        "foul, hung, modes": FlightOutcome.LEFT_OFFBOARD,
        "killed for long": FlightOutcome.CONTROLLER_LOST,
        "killed for a moment": FlightOutcome.DONE,
    }
    assert flight.outcome is expected[script]
    assert infer_outcome(flight.records, SCRIPTS[script]) is flight.outcome


def test_foul_link_in_real_time_equals_lockstep_to_the_bit():
    scenario = replace(GUSTY, link=FOUL)
    assert b"".join(RealTime(scenario).rows) == loopback(scenario).tobytes()


def test_same_seed_is_the_same_flight_and_another_is_not():
    scenario = replace(GUSTY, link=FOUL, wind=())
    flown = loopback(scenario)
    assert loopback(scenario).tobytes() == flown.tobytes()
    assert loopback(scenario, seed=8).tobytes() != flown.tobytes()


def test_scenario_twice_as_long_begins_identically():
    scenario = replace(SCRIPTS["foul, hung, modes"], duration_s=2.0)
    longer = loopback(replace(scenario, duration_s=4.0))
    assert longer[: scenario.samples].tobytes() == loopback(scenario).tobytes()


def test_link_faults_leave_gusts_and_noise_as_they_were():
    foul, clean = loopback(replace(GUSTY, link=FOUL)), loopback(GUSTY)
    assert foul["gust_B"].tobytes() == clean["gust_B"].tobytes()
    assert foul.tobytes() != clean.tobytes()


def test_staircase_of_delay_leads_past_the_margin_to_instability():
    # The scheduled law's delay margin is 11 ms beyond one sample: 8 ms more are flown, 12 ms are not.
    steps = tuple(LinkDelay(kind="delay", delay_s=SAMPLE_S, start_s=3.0 * n, **UP) for n in (1, 2, 3, 4))
    flown = loopback(replace(load_scenario("calm"), duration_s=15.0, link=steps))
    rates = np.abs(flown["omega_B"]).max(axis=1).reshape(5, -1)  # step by step
    settled = rates[:, -250:].max(axis=1)
    assert settled[:3].max() < 0.02  # [rad/s] noise
    growing = rates[3].reshape(3, -1).max(axis=1)
    assert growing[0] < growing[1] < growing[2]
    assert settled[4] > 1.0


@pytest.mark.parametrize("direction", ["to_vehicle", "to_controller"])
def test_lost_link_is_a_lost_stream_after_its_time_out(direction):
    cut = Loss(kind="loss", direction=direction, probability=1.0, start_s=1.0, stop_s=3.0)
    flight = RealTime(replace(GUSTY, link=(cut,)))
    looped = loopback(replace(GUSTY, link=(cut,)))
    # The last set-point arrived at .996 s.
    assert phases(looped) == [(OFFBOARD, 0.0), (STABILIZED, 1.996)]
    assert b"".join(flight.rows) == looped.tobytes()
    assert flight.vehicle.outcome is VehicleOutcome.STREAM_LOST
    assert flight.vehicle.flight.counters[TimingFault.HELD] == 250


def test_outage_shorter_than_the_time_out_is_flown_through_at_the_attitude_of_its_beginning():
    cut = Loss(kind="loss", probability=1.0, start_s=1.0, stop_s=1.4, **UP)
    flown = loopback(replace(GUSTY, link=(cut,)))
    assert phases(flown) == [(OFFBOARD, 0.0)]
    held, stalled = flown["torque_command_B"][250:263], flown["omega_command_B"][263:350]
    assert np.all(held == held[0])  # the last command, for 50 ms and the sample of delay
    assert np.isfinite(stalled).all()  # the rates that the vehicle's own attitude loop wants
    assert np.isnan(flown["omega_command_B"][[262, 352]]).all()
    unstopped = loopback(GUSTY)
    apart = np.degrees(euler_angles(flown["q_NB"]) - euler_angles(unstopped["q_NB"]))
    assert np.abs(apart).max() < 1.5
    assert np.abs(apart[-1]).max() < 0.5


def test_hung_controller_loses_the_vehicle_and_gets_it_back_when_offboard_is_set():
    hang = ControllerHang(kind="controller_hung", at_s=0.5, for_s=1.5)
    early, back = (ModeChange(kind="mode", at_s=at_s, mode="offboard") for at_s in (1.8, 2.4))
    flown = loopback(replace(GUSTY, event=(hang, early, back)))
    # Without current set-points it is refused.
    assert phases(flown) == [(OFFBOARD, 0.0), (STABILIZED, 1.496), (OFFBOARD, 2.4)]


def test_killed_controller_is_replaced_and_the_next_one_asks_for_offboard():
    assert phases(loopback(SCRIPTS["killed for long"])) == [(OFFBOARD, 0.0), (STABILIZED, 1.496), (OFFBOARD, 2.3)]


@pytest.mark.parametrize("direction", [UP, DOWN])
def test_what_was_on_its_way_to_a_killed_controller_is_not_asked_of_the_next_one(direction):
    delay = LinkDelay(kind="delay", delay_s=0.01, **direction)
    flown = loopback(replace(GUSTY, duration_s=1.0, event=(KILLED_FOR_A_MOMENT,), link=(delay,)))
    assert phases(flown) == [(OFFBOARD, 0.0)]


def test_controller_that_takes_over_within_the_time_out_begins_afresh():
    killed, hung = (
        loopback(replace(GUSTY, event=(item,)))
        for item in (KILLED_FOR_A_MOMENT, ControllerHang(kind="controller_hung", at_s=0.5, for_s=0.1))
    )
    assert phases(killed) == phases(hung) == [(OFFBOARD, 0.0)]
    back = 150 + GUSTY.delay_samples
    assert killed[:back].tobytes() == hung[:back].tobytes()
    assert killed[back]["torque_command_B"].tolist() != hung[back]["torque_command_B"].tolist()
    limit = published_limit(VEHICLE)
    gyro_B, force_B = (tuple(killed[150][name].tolist()) for name in ("gyro_B", "specific_force_B"))
    first = LawStepper(load_law("hinf-scheduled"), limit).step(gyro_B, force_B)
    assert killed[back]["torque_command_B"] == pytest.approx(np.multiply(first, limit), rel=1e-12)


def test_killed_controller_without_another_is_not_waited_for():
    killed = ControllerKill(kind="controller_killed", at_s=0.5)
    flown = loopback(replace(GUSTY, event=(killed,)))
    assert phases(flown) == [(OFFBOARD, 0.0), (STABILIZED, 1.496)]
    assert len(flown) == GUSTY.samples


def test_modes_are_set_as_a_ground_station_would():
    events = tuple(ModeChange(kind="mode", at_s=at_s, mode=mode) for at_s, mode in ((1.0, "hold"), (2.0, "offboard")))
    flown = loopback(replace(GUSTY, event=events))
    assert phases(flown) == [(OFFBOARD, 0.0), (HOLD, 1.0), (OFFBOARD, 2.0)]


def test_mode_that_the_vehicle_refuses_is_counted():
    event = (ModeChange(kind="mode", at_s=1.0, mode="return"),)  # held on the stand
    flight = RealTime(replace(GUSTY, event=event))
    assert flight.vehicle.flight.counters[TimingFault.REFUSED] == 1
    assert flight.vehicle.outcome is VehicleOutcome.DONE


def test_free_vehicle_lands_by_script_and_ends_before_it():
    landing = ModeChange(kind="mode", at_s=0.5, mode="land")
    scenario = replace(GUSTY, duration_s=60.0, translation="free", altitude_m=2.0, wind=(), event=(landing,))
    flown = loopback(scenario)
    assert [mode for mode, _ in phases(flown)[:2]] == [OFFBOARD, Mode.LAND]
    assert len(flown) < scenario.samples
    # A journal shows it too: this was its end.
    assert infer_outcome(flown, scenario) is FlightOutcome.LEFT_OFFBOARD
    assert describe(FlightOutcome.LEFT_OFFBOARD, scenario, flown) == "flown as scripted: LAND from 0.5 s"
    assert infer_outcome(flown[:-1], scenario) is FlightOutcome.CUT_OFF


@pytest.mark.parametrize("seed", range(1, 9))
def test_what_a_link_does_is_told_before_the_flight_and_flown_without_messages_to_the_same_bits(seed):
    chance = random.Random(seed)
    begins = [0.0, 0.3, 0.55]
    windows = [(begin, begin + chance.choice((0.1, 0.4, 3.0))) for begin in chance.sample(begins, 3)]
    faults = [replace(each, start_s=begin, stop_s=end) for each in FOUL for begin, end in (chance.choice(windows),)]
    slow = Bandwidth(kind="bandwidth", rate_bit_s=chance.choice((9e4, 1.3e5)), queue=chance.choice((0, 3, 40)), **UP)
    hung = ControllerHang(kind="controller_hung", at_s=0.5, for_s=chance.choice((0.01, 0.06, 0.3)))
    for law in (load_law("hinf-scheduled"), load_law("hinf-rates")):
        script = replace(GUSTY, duration_s=1.5, link=(*chance.sample(faults, 7), slow), event=(hung,))
        script = replace(script, delay_samples=chance.choice((0, 3)))
        flown = fly_direct(script, law, vehicle=VEHICLE, seed=seed)
        assert flown.tobytes() == loopback(script, law.name, seed=seed).tobytes()
        assert np.unique(flown["command_age"]).size > 3


def test_without_commands_for_a_second_the_mode_changes_and_messages_are_needed():
    hung = ControllerHang(kind="controller_hung", at_s=0.5, for_s=0.9)
    flown = fly_direct(replace(GUSTY, event=(hung,)), load_law("flagship"), vehicle=VEHICLE)
    assert np.nanmax(flown["command_age"]) > 200.0  # it held its attitude
    for events in (
        (replace(hung, for_s=1.1),),
        (KILLED_FOR_A_MOMENT,),
        (ModeChange(kind="mode", at_s=0.5, mode="land"),),
    ):
        with pytest.raises(NeedsMessages, match="must be flown with messages"):
            fly_direct(replace(GUSTY, event=events), load_law("flagship"), vehicle=VEHICLE)


def test_every_mode_of_the_tables_is_one_of_the_autopilots():
    names = ModeChange.__dataclass_fields__["mode"].type.__args__
    assert {Mode[name.upper()] for name in names} == set(Mode) - {Mode.ACRO}
