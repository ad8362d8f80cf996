"""The pace of a flight on a virtual clock, with a vehicle that only counts its samples."""

import math

import numpy as np
import pytest

from firmware_model.autopilot.modes import Autopilot, AutopilotEvent, Mode, Settings, TransitionResult
from firmware_model.mavlink.frames import RejectReason
from firmware_model.session.pacing import FlightClock, NextAction, TimingFault
from firmware_model.types import AttitudeTarget, Command, LevelFlight, MotorsOff, Setpoint, TorqueCommand

SAMPLE_US = 4_000
RESEND_US, MAX_RESENDS = 100_000, 30
MAX_CATCH_UP_US, STALL_US = 250_000, 50_000
SCRIPT = 1_000  # samples


class Counting:
    """As much of a vehicle as a flight asks for: it stays where the test puts it."""

    def __init__(self) -> None:
        self.flown: list[tuple[Setpoint, int]] = []
        self.estimate_q_NB = (1.0, 0.0, 0.0, 0.0)
        self.position_N = (0.0, 0.0, 0.0)

    @property
    def on_ground(self) -> bool:
        return self.position_N[2] >= 0.0

    @property
    def finished(self) -> bool:
        return len(self.flown) >= SCRIPT

    def observe(self) -> None:
        pass

    def true_vector(self, name: str) -> tuple[float, float, float]:
        assert name == "position_N"
        return self.position_N

    def advance(self, setpoint: Setpoint, mode: int) -> np.ndarray:
        self.flown.append((setpoint, mode))
        return np.empty(0)


class Paced:
    """A flight in real time and its clock."""

    def __init__(self, *, standing: bool = True, free: bool = True) -> None:
        self.loop = Counting()
        self.autopilot = Autopilot(Settings(), free=free)
        self.flight = FlightClock(
            self.loop, self.autopilot, lambda _: None, sample_us=SAMPLE_US, lockstep=False, interactive=standing
        )
        self.now_us = 7_000_000
        self.poll()

    def poll(self) -> int:
        """Fly what is due; return how many samples that were."""
        if self.flight.is_ready():
            self.flight.begin(self.now_us)
        before = len(self.loop.flown)
        while self.flight.next_action(self.now_us) is NextAction.ADVANCE:
            self.flight.advance(self.now_us)
        return len(self.loop.flown) - before

    def wait(self, us: int) -> int:
        """Let the process sleep through."""
        self.now_us += us
        return self.poll()

    def run(self, us: int) -> int:
        """Be served on every deadline."""
        end_us, flown = self.now_us + us, 0
        while (deadline_us := self.flight.deadline_us()) is not None and deadline_us <= end_us:
            self.now_us = max(deadline_us, self.now_us)
            flown += self.poll()
        self.now_us = end_us
        return flown

    def offer(self, time_us: int = 0, thrust: float = 0.5) -> RejectReason | None:
        command = AttitudeTarget(time_us=time_us, q_NB=(1.0, 0.0, 0.0, 0.0), omega_B=None, thrust=thrust)
        return self.give(command)

    def offer_torque(self, time_us: int) -> RejectReason | None:
        return self.give(TorqueCommand(time_us=time_us, torque_B=(0.0, 0.0, 0.0), throttle=0.5))

    def give(self, command: Command) -> RejectReason | None:
        self.flight.tick(self.now_us)
        return self.flight.offer(command)

    def enter_offboard(self) -> None:
        self.offer()
        assert self.autopilot.set_mode(Mode.OFFBOARD) is TransitionResult.ACCEPTED
        assert self.autopilot.arm() is TransitionResult.ACCEPTED
        self.loop.position_N = (0.0, 0.0, -10.0)


@pytest.fixture
def paced() -> Paced:
    return Paced()


def test_standing_vehicle_begins_at_once_and_flies_by_the_clock_without_end(paced):
    assert paced.run(10_000_000) == 2_500
    assert set(paced.loop.flown) == {(MotorsOff(), Mode.STABILIZED.value)}
    assert paced.flight.running
    assert not paced.flight.counters


@pytest.mark.parametrize("late_us", [3 * SAMPLE_US, MAX_CATCH_UP_US])
def test_late_samples_are_made_up_for_within_the_bound(paced, late_us):
    paced.run(1_000_000)
    assert paced.wait(SAMPLE_US + late_us) == 1 + late_us // SAMPLE_US
    assert paced.flight.slipped_us == 0
    assert paced.flight.counters[TimingFault.OVERRUN] == (late_us - 1) // SAMPLE_US  # one sample time late is in time
    assert paced.run(1_000_000) in (250, 251)


def test_each_sample_is_counted_by_its_own_delay(paced):
    paced.run(1_000_000)
    paced.wait(3 * SAMPLE_US + 5)  # three samples, two of them kept waiting
    assert paced.flight.latency.stats() == {"p50_us": 0, "p99_us": 5, "worst_us": 2 * SAMPLE_US + 5}
    assert paced.flight.counters[TimingFault.OVERRUN] == 2


def test_beyond_the_bound_model_time_slips_and_that_is_said(paced):
    paced.run(1_000_000)
    assert paced.wait(SAMPLE_US + MAX_CATCH_UP_US + 1) == 1
    assert paced.flight.slipped_us == MAX_CATCH_UP_US + 1
    assert paced.flight.counters == {TimingFault.OVERRUN: 1, TimingFault.SLIPPED: 1}
    assert paced.autopilot.take_events() == [AutopilotEvent.SLIPPED]
    assert paced.run(1_000_000) == 250
    assert paced.wait(3_600_000_000) == 1


def test_a_machine_that_is_too_slow_all_the_time_says_so_every_ten_seconds(paced):
    said = 0
    for _ in range(100):
        paced.wait(MAX_CATCH_UP_US + 2 * SAMPLE_US)
        said += len(paced.autopilot.take_events())
    assert paced.flight.counters[TimingFault.SLIPPED] == 100
    assert said == 3  # 25.8 s


def test_time_outs_run_on_model_time_and_wait_with_it(paced):
    paced.enter_offboard()
    paced.run(900_000)
    paced.wait(60_000_000)  # a suspended machine: nobody had the time to send a set-point
    assert paced.autopilot.mode is Mode.OFFBOARD
    paced.run(200_000)
    assert paced.autopilot.mode is Mode.STABILIZED


def test_stream_that_stops_is_flown_for_the_time_out_and_then_not(paced):
    paced.enter_offboard()
    paced.run(2_000_000)
    commanded = [isinstance(setpoint, AttitudeTarget) for setpoint, _ in paced.loop.flown]
    assert commanded == [True] * 250 + [False] * 250
    assert paced.loop.flown[-1] == (LevelFlight(), Mode.STABILIZED.value)
    assert paced.autopilot.take_events() == [AutopilotEvent.LOST_STABILIZED]


def test_older_stamp_is_stale_while_its_stream_lives_and_fresh_when_that_is_dead(paced):
    assert paced.offer(time_us=8_000) is None
    paced.run(500_000)
    assert paced.offer(time_us=4_000) is RejectReason.STALE
    paced.run(600_000)
    assert paced.offer(time_us=0) is None


@pytest.mark.parametrize("first_ms", [2**32 - 1000, 0])
def test_stream_goes_on_across_the_wrap_of_its_stamps(paced, first_ms):
    paced.enter_offboard()
    paced.flight._forget_setpoint()
    for k in range(200):
        assert paced.offer(time_us=(first_ms + 10 * k) % 2**32 * 1000) is None
        paced.run(10_000)
    assert paced.autopilot.mode is Mode.OFFBOARD


@pytest.mark.parametrize("wrong_ms", [2**31 - 10, 2**31 + 10, 10**6, 3_000])
def test_one_stamp_of_the_future_ends_no_stream(paced, wrong_ms):
    paced.enter_offboard()
    reasons = []
    for k in range(200):
        reasons.append(paced.offer(time_us=1000 * (wrong_ms if k == 60 else 10 * k)))
        paced.run(10_000)
    assert paced.autopilot.mode is Mode.OFFBOARD
    assert reasons[:61] == [None] * 61
    assert reasons.count(RejectReason.STALE) <= 10  # .1 s
    assert reasons[80:] == [None] * 120


def test_stream_whose_clock_runs_back_is_flown(paced):
    paced.enter_offboard()
    paced.flight._forget_setpoint()
    for k in range(300):
        paced.offer(time_us=10_000_000 - 10_000 * k)
        paced.run(10_000)
    assert paced.autopilot.mode is Mode.OFFBOARD


def test_late_set_points_among_newer_ones_are_never_flown(paced):
    paced.enter_offboard()
    for k in range(1, 200):
        assert paced.offer(time_us=10_000 * k) is None
        assert paced.offer(time_us=max(10_000 * (k - 50), 0)) is RejectReason.STALE
        assert paced.offer_torque(time_us=10_000 * k) is None  # another message makes no stamp fresh
        paced.run(10_000)


def test_old_stamps_of_one_message_alone_are_those_of_a_new_clock_beside_another_stream(paced):
    paced.enter_offboard()
    assert paced.offer(time_us=10_000_000) is None
    reasons = []
    for k in range(20):
        reasons.append(paced.offer(time_us=10_000 * k))
        assert paced.offer_torque(time_us=10_000 * k) is None
        paced.run(10_000)
    assert reasons == [RejectReason.STALE] * 10 + [None] * 10


def test_an_old_stamp_that_is_repeated_is_never_that_of_a_new_clock(paced):
    paced.enter_offboard()
    assert paced.offer(time_us=10_000_000) is None
    for _ in range(40):
        assert paced.offer(time_us=5_000) is RejectReason.STALE
        assert paced.offer_torque(time_us=1) is None
        paced.run(10_000)


def test_flight_compares_stamps_within_a_message(paced):
    assert paced.offer(time_us=5_417_184_000) is None  # MAVSDK: ms, as the message has it
    assert paced.offer_torque(time_us=5_419_788) is None  # ms again, where the message has us
    assert isinstance(paced.flight.setpoint, TorqueCommand)
    assert paced.offer_torque(time_us=5_419_787) is RejectReason.STALE
    assert paced.offer(time_us=5_417_183_000) is RejectReason.STALE
    assert paced.offer(time_us=5_420_000_000) is None
    paced.run(1_100_000)  # a stream that has died takes all its stamps with it
    assert paced.offer_torque(time_us=1) is paced.offer(time_us=1_000) is None


def test_flooding_controller_is_flown_by_its_newest_set_point(paced):
    paced.enter_offboard()
    for sample in range(100):
        for number in range(20):
            paced.offer(time_us=20 * sample + number, thrust=number / 20)
        paced.run(SAMPLE_US)
    assert {setpoint.thrust for setpoint, _ in paced.loop.flown} == {0.95}
    assert not paced.flight.counters


def test_stamp_time_runs_between_samples_and_never_into_the_next(paced):
    paced.run(SAMPLE_US)
    assert paced.flight.sample_age_us(paced.now_us + 1_000) == 1_000
    assert paced.flight.sample_age_us(paced.now_us + 1_000_000) == SAMPLE_US


def test_scripted_flight_waits_for_its_controller_and_ends_with_the_script():
    paced = Paced(standing=False)
    assert paced.wait(60_000_000) == 0
    paced.enter_offboard()
    paced.poll()
    assert paced.run(5_000_000) == SCRIPT
    assert not paced.flight.running
    assert paced.flight.ended_us == 7_000_000 + 60_000_000 + SCRIPT * SAMPLE_US
    assert not paced.autopilot.armed


def test_scripted_flight_ends_before_its_script_by_landing():
    paced = Paced(standing=False, free=False)
    paced.enter_offboard()
    paced.poll()
    paced.run(400_000)
    paced.autopilot.land()
    assert paced.run(5_000_000) < SCRIPT
    assert paced.flight.ended_us is not None
    assert paced.autopilot.take_events() == [AutopilotEvent.LANDED]


def test_pause_stops_model_time_and_nothing_is_made_up_for(paced):
    paced.enter_offboard()
    paced.run(900_000)
    paced.flight.pause(paced.now_us, paused=True)
    assert paced.run(60_000_000) == 0
    paced.flight.pause(paced.now_us, paused=False)
    assert paced.run(80_000) == 20
    assert paced.autopilot.mode is Mode.OFFBOARD
    assert (paced.flight.paused_us, paced.flight.slipped_us) == (60_000_000, 0)
    assert paced.flight.wall_us == 980_000
    assert TimingFault.OVERRUN not in paced.flight.counters


def test_pause_before_the_first_sample_holds_it_back():
    paced = Paced(standing=False)
    paced.flight.pause(paced.now_us, paused=True)
    paced.now_us += 5_000_000
    paced.enter_offboard()
    assert paced.poll() == 0
    assert paced.run(1_000_000) == 0
    paced.flight.pause(paced.now_us, paused=False)
    assert paced.run(40_000) == 10
    assert paced.flight.paused_us == 1_000_000


TILTED = (0.8, 0.6, 0.0, 0.0)


def stream(paced: Paced, every_us: int, count: int, command: Command) -> None:
    """Send a set-point again and again."""
    for _ in range(count):
        paced.give(command._replace(time_us=paced.now_us))
        paced.run(every_us)


TORQUES = TorqueCommand(time_us=0, torque_B=(0.1, 0.0, 0.0), throttle=0.5)
RATES = AttitudeTarget(time_us=0, q_NB=None, omega_B=(0.1, 0.0, 0.0), thrust=0.5)


@pytest.mark.parametrize("command", [TORQUES, RATES], ids=["torques", "rates"])
def test_stalled_stream_holds_the_attitude_until_the_next_setpoint(paced, command):
    paced.enter_offboard()
    stream(paced, SAMPLE_US, 10, command)
    last, hold = (
        paced.loop.flown[-1][0],
        AttitudeTarget(time_us=paced.now_us - SAMPLE_US, q_NB=TILTED, omega_B=None, thrust=0.5),
    )
    assert last == command._replace(time_us=hold.time_us)
    paced.loop.flown.clear()
    paced.loop.estimate_q_NB = TILTED
    paced.run(STALL_US + SAMPLE_US)
    paced.loop.estimate_q_NB = (1.0, 0.0, 0.0, 0.0)  # the vehicle turns on, and is turned back
    paced.run(2 * SAMPLE_US)
    assert [setpoint for setpoint, _ in paced.loop.flown] == [last] * (STALL_US // SAMPLE_US) + [hold] * 3
    assert {mode for _, mode in paced.loop.flown} == {Mode.OFFBOARD.value}
    assert paced.flight.counters[TimingFault.STALLED] == 1
    assert paced.autopilot.take_events() == [AutopilotEvent.STALLED]
    stream(paced, SAMPLE_US, 3, command)
    assert paced.loop.flown[-1][0] == command._replace(time_us=paced.now_us - SAMPLE_US)
    paced.run(STALL_US + SAMPLE_US)
    assert paced.flight.counters[TimingFault.STALLED] == 2
    assert paced.autopilot.take_events() == []  # told once in a flight


@pytest.mark.parametrize("every_us", [50_000, 100_000, 400_000])
def test_slow_stream_does_not_stall(paced, every_us):
    paced.enter_offboard()
    stream(paced, every_us, 2, TORQUES)
    stalls = paced.flight.counters[TimingFault.STALLED]
    stream(paced, every_us, 10, TORQUES)
    assert paced.flight.counters[TimingFault.STALLED] == stalls


def test_held_attitude_setpoint_stays_as_it_is(paced):
    paced.enter_offboard()
    stream(paced, SAMPLE_US, 3, AttitudeTarget(time_us=0, q_NB=TILTED, omega_B=(0.1, 0.0, 0.0), thrust=0.5))
    flown = paced.loop.flown[-1]
    paced.run(2 * STALL_US)
    assert paced.loop.flown[-1] == flown
    assert not paced.flight.counters[TimingFault.STALLED]


class Stepped(Paced):
    """A scripted flight in lockstep, in OFFBOARD from sample 0."""

    def __init__(self) -> None:
        self.loop, self.autopilot = Counting(), Autopilot(Settings(), free=True)
        self.flight = FlightClock(self.loop, self.autopilot, lambda _: None, sample_us=SAMPLE_US, lockstep=True)
        self.now_us = 7_000_000
        self.enter_offboard()
        self.poll()


def test_lockstep_flies_a_sample_as_soon_as_it_is_answered_and_never_before():
    stepped = Stepped()
    assert len(stepped.loop.flown) == 1  # sample 0 was answered before the flight
    assert stepped.wait(RESEND_US - 1) == 0
    assert stepped.offer(4_000) is None
    assert stepped.poll() == 1
    assert stepped.flight.time_us == 2 * SAMPLE_US
    assert not stepped.flight.counters
    assert stepped.flight.sample_age_us(stepped.now_us + 1_000) == 0  # its time stands


def test_lockstep_takes_one_answer_to_the_current_sample():
    stepped = Stepped()
    assert stepped.offer(8_000) is RejectReason.EARLY
    assert stepped.offer(0) is RejectReason.DUPLICATE
    assert stepped.offer_torque(4_001) is RejectReason.EARLY
    assert stepped.offer_torque(3_999) is RejectReason.STALE
    assert stepped.offer(4_000) is None
    assert stepped.offer(4_000) is RejectReason.DUPLICATE
    stepped.poll()
    assert stepped.offer(0) is RejectReason.STALE


def test_lockstep_sample_is_sent_again_and_then_flown_by_the_fail_safe():
    stepped = Stepped()
    begun_us, resent = stepped.now_us, []
    while stepped.autopilot.mode is Mode.OFFBOARD:
        deadline_us = stepped.flight.deadline_us()
        assert stepped.flight.next_action(deadline_us - 1) is NextAction.WAIT
        stepped.now_us = deadline_us
        action = stepped.flight.next_action(stepped.now_us)
        if action is NextAction.RESEND:
            resent.append(stepped.now_us - begun_us)
        else:
            stepped.flight.advance(stepped.now_us)
    assert resent == [k * RESEND_US for k in range(1, MAX_RESENDS + 1)]
    assert stepped.now_us - begun_us == (MAX_RESENDS + 1) * RESEND_US
    assert stepped.flight.counters == {TimingFault.RESENT: MAX_RESENDS}
    assert stepped.autopilot.in_fail_safe
    assert stepped.flight.setpoint is None
    assert stepped.flight.deadline_us() <= stepped.now_us  # the fail-safe waits for nobody
    assert stepped.poll() == SCRIPT - 2
    assert stepped.flight.left_offboard


def test_pause_in_lockstep_sends_the_sample_again_a_full_time_out_after_it():
    stepped = Stepped()
    stepped.flight.pause(stepped.now_us, paused=True)
    stepped.flight.pause(stepped.now_us + 1, paused=True)  # again: the pause began with the first
    assert stepped.wait(90_000) == 0
    assert stepped.flight.deadline_us() > stepped.now_us + 3_600_000_000
    stepped.flight.pause(stepped.now_us, paused=False)
    stepped.flight.pause(stepped.now_us + 1, paused=False)
    assert stepped.flight.paused_us == 90_000
    assert stepped.flight.deadline_us() == stepped.now_us + RESEND_US


def test_pause_that_ends_before_the_first_sample_leaves_no_trace():
    paced = Paced(standing=False)
    paced.flight.pause(paced.now_us, paused=True)
    paced.now_us += 5_000_000
    paced.flight.pause(paced.now_us, paused=False)
    paced.enter_offboard()
    paced.poll()
    assert paced.run(40_000) == 10
    assert (paced.flight.paused_us, paced.flight.wall_us) == (0, 40_000)


def test_wall_time_of_a_flight_counts_from_its_first_sample_to_its_last():
    paced = Paced(standing=False)
    assert paced.flight.wall_us == 0
    assert paced.flight.deadline_us() is None
    assert paced.flight.clock_us(paced.now_us) == paced.now_us
    paced.enter_offboard()
    paced.poll()
    paced.run(40_000)
    assert paced.flight.wall_us == 40_000
    assert paced.flight.clock_us(paced.now_us + 1) == 7_000_000 + 40_000


def test_a_vehicle_upside_down_has_a_tilt_whatever_the_rounding(paced):
    paced.loop.estimate_q_NB = (0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0)  # the sum of squares is above 1
    paced.run(SAMPLE_US)
    assert paced.autopilot.arm() is TransitionResult.TIPPED


@pytest.mark.parametrize("tilt_deg", [44.0, 46.0])
def test_tilt_and_heading_of_the_estimate_reach_the_autopilot(paced, tilt_deg):
    half, heading = math.radians(tilt_deg) / 2, math.radians(70.0) / 2
    # Heading about z first, then the tilt about the body's x axis.
    paced.loop.estimate_q_NB = (
        math.cos(heading) * math.cos(half),
        math.cos(heading) * math.sin(half),
        math.sin(heading) * math.sin(half),
        math.sin(heading) * math.cos(half),
    )
    paced.run(SAMPLE_US)
    refused = tilt_deg > 45.0
    assert paced.autopilot.arm() is (TransitionResult.TIPPED if refused else TransitionResult.ACCEPTED)
    paced.loop.position_N = (0.0, 0.0, -10.0)
    paced.autopilot.hold()
    paced.run(SAMPLE_US)
    if not refused:
        setpoint, _ = paced.loop.flown[-1]
        assert setpoint.yaw == pytest.approx(math.radians(70.0))
