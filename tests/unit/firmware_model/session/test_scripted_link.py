"""The scripted link on a virtual clock, between a vehicle that only counts and a controller that answers stamps."""

from collections.abc import Callable

import numpy as np
import pytest

from firmware_model.autopilot.modes import Autopilot, Mode, Settings, TransitionResult
from firmware_model.config.files import validate
from firmware_model.config.scenario import Scenario
from firmware_model.mavlink.frames import RejectReason
from firmware_model.session.pacing import STALL_US, FlightClock, NextAction, TimingFault
from firmware_model.session.scripted_link import ScriptedLink
from firmware_model.types import NEVER_US, AttitudeTarget, Command, ImuSample, Setpoint, TorqueCommand, Trim

SAMPLE_US, SIZE = 4_000, 43
BEGIN_US = 7_000_000
RESEND_US, MAX_RESENDS, JOIN_TIMEOUT_US = 100_000, 30, 60_000_000
DELAYED = {"kind": "delay", "direction": "to_controller", "delay_s": 0.008}
Answer = Callable[[ImuSample], Command | None]


class Counting:
    """As much of a vehicle as a flight over a link asks for."""

    estimate_q_NB = (1.0, 0.0, 0.0, 0.0)
    on_ground = False

    def __init__(self, samples: int) -> None:
        self.samples = samples
        self.flown: list[Setpoint] = []

    @property
    def sample(self) -> int:
        return len(self.flown)

    @property
    def time_us(self) -> int:
        return self.sample * SAMPLE_US

    @property
    def finished(self) -> bool:
        return self.sample >= self.samples

    def observe(self) -> ImuSample:
        return ImuSample(self.time_us, (0.0, 0.0, 0.0), (0.0, 0.0, -9.80665))

    def true_vector(self, _: str) -> tuple[float, float, float]:
        return 0.0, 0.0, -10.0

    def advance(self, setpoint: Setpoint, _: int) -> np.ndarray:
        self.flown.append(setpoint)
        return np.empty(0)


def torque(time_us: int) -> TorqueCommand:
    return TorqueCommand(time_us=time_us, torque_B=(0.1, 0.0, 0.0), throttle=None)


def obedient(sample: ImuSample) -> Command | None:
    return torque(sample.time_us)


def silent(_: ImuSample) -> Command | None:
    return None


class Linked:
    """A flight in OFFBOARD over a link with the tables of a script; its controller is asked for each sample."""

    def __init__(self, *tables: dict, samples: int = 20, lockstep: bool = True) -> None:
        content = {"link": [item for item in tables if "direction" in item]}
        content["event"] = [item for item in tables if "direction" not in item]
        content |= {"name": "linked", "description": "", "duration_s": samples * SAMPLE_US * 1e-6}
        self.loop, self.autopilot = Counting(samples), Autopilot(Settings(), free=False)
        self.flight = FlightClock(
            self.loop,
            self.autopilot,
            lambda _: None,
            sample_us=SAMPLE_US,
            lockstep=lockstep,
            has_scripted_link=True,
        )
        self.link = ScriptedLink(validate(Scenario, content, ""), 1, self.flight, self.loop)
        self.now_us = BEGIN_US
        self.asked: list[tuple[int, int]] = []
        self.events: list[str] = []
        self.flight.tick(self.now_us)
        assert self.flight.offer(torque(0)) is None
        assert self.autopilot.set_mode(Mode.OFFBOARD) is TransitionResult.ACCEPTED
        assert self.autopilot.arm() is TransitionResult.ACCEPTED
        self.flight.begin(self.now_us)
        self.begin_sample()

    def begin_sample(self) -> None:
        self.events += [event.kind for event in self.link.begin_sample(self.now_us) or ()]

    def ask(self, answer: Answer, sample: ImuSample) -> None:
        """Give a sample to the controller, and its answer to the link."""
        self.asked.append((self.now_us, sample.time_us))
        command = answer(sample)
        if command is not None:
            assert self.link.offer(command, SIZE, self.stamp_us) is None

    @property
    def stamp_us(self) -> int:
        return self.loop.time_us + self.flight.sample_age_us(self.now_us)

    def fly(self, answer: Answer = obedient, *, until: int = NEVER_US) -> list[Setpoint]:
        """Fly until a sample or the end of the script; return what has been flown so far."""
        while self.flight.running and self.loop.sample < until:
            action = self.link.next_action(self.now_us)
            if action is NextAction.RESEND:
                self.ask(answer, self.link.sample)
            elif action is NextAction.ADVANCE:
                self.flight.advance(self.now_us)
                if self.flight.running:
                    self.begin_sample()
            else:
                deadline_us = self.link.deadline_us()
                if deadline_us >= NEVER_US:
                    break
                self.now_us = max(self.now_us, deadline_us)
            if not self.flight.lockstep:
                for sample in list(self.link.take_deliveries(self.stamp_us)):
                    self.ask(answer, sample)
        return self.loop.flown

    def counts(self, direction: str) -> dict[str, int]:
        return self.link.stats()[direction]


def stamps(flown: list[Setpoint]) -> list[int | None]:
    """Return the number of the sample that each set-point answers; `None` for trim."""
    return [None if isinstance(item, Trim) else item.time_us // SAMPLE_US for item in flown]


@pytest.mark.parametrize("lockstep", [True, False])
@pytest.mark.parametrize("directions", [("to_controller", "to_vehicle"), ("to_vehicle",), ("to_controller",)])
def test_vehicle_is_trimmed_until_the_first_answer_and_then_flies_each_one_late(directions, lockstep):
    tables = [{"kind": "delay", "direction": name, "delay_s": 0.004} for name in directions]
    linked = Linked(*tables, lockstep=lockstep)
    delay = len(directions)
    assert stamps(linked.fly()) == [None] * delay + list(range(20 - delay))
    assert linked.counts("to_controller")["sent"] == 20
    assert linked.counts("to_vehicle")["arrived"] == 20 - delay
    assert linked.flight.counters == {TimingFault.HELD: delay}


def test_answer_that_arrives_within_a_sample_is_flown_with_it():
    late = {"kind": "delay", "direction": "to_controller", "delay_s": 0.003_999}
    assert stamps(Linked(late).fly()) == list(range(20))
    assert stamps(Linked({**late, "delay_s": 0.004}).fly())[:3] == [None, 0, 1]


@pytest.mark.parametrize("lockstep", [True, False])
def test_last_set_point_is_held_while_its_successor_is_lost(lockstep):
    lossy = {"kind": "loss", "direction": "to_vehicle", "probability": 1.0, "start_s": 0.02, "stop_s": 0.032}
    linked = Linked(lossy, lockstep=lockstep)
    flown = stamps(linked.fly())
    shift = 0 if lockstep else flown.index(0)  # in real time the answer comes after the sample is taken
    lost = [k for k in range(20) if 5 <= k < 8]
    expected = [k if k not in lost else 4 for k in range(20)]
    assert flown[shift:] == expected[: 20 - shift]
    assert linked.counts("to_vehicle")["lost"] == 3
    assert linked.flight.counters[TimingFault.HELD] == 3 + shift


@pytest.mark.parametrize("lockstep", [True, False])
def test_older_answer_that_is_overtaken_is_not_flown(lockstep):
    held = {"kind": "reordering", "direction": "to_vehicle", "probability": 0.5, "by_s": 0.010}
    linked = Linked(held, samples=200, lockstep=lockstep)
    flown = [k for k in stamps(linked.fly()) if k is not None]
    assert flown == sorted(flown)
    counts = linked.counts("to_vehicle")
    assert counts["held_back"] > counts["overtaken"] > 20


def test_overtaken_sample_is_answered_by_no_law_and_not_waited_for():
    held = {"kind": "reordering", "direction": "to_controller", "probability": 0.5, "by_s": 0.010}
    linked = Linked(held, samples=200)
    newest = -1

    def law(sample: ImuSample) -> Command | None:
        nonlocal newest
        if sample.time_us < newest:
            return None
        newest = sample.time_us
        return torque(newest)

    flown = [k for k in stamps(linked.fly(law)) if k is not None]
    assert flown == sorted(flown)
    assert linked.now_us == BEGIN_US  # nothing was waited for
    assert TimingFault.RESENT not in linked.flight.counters


def test_duplicate_of_a_sample_is_answered_again():
    double = {"kind": "duplication", "direction": "to_controller", "probability": 1.0}
    linked = Linked(double)
    linked.fly()
    assert [stamp_us for _, stamp_us in linked.asked] == [k * SAMPLE_US for k in range(20) for _ in range(2)]
    assert linked.counts("to_vehicle")["sent"] == 40


def test_hanging_controller_gets_no_samples_and_goes_on_with_the_next():
    step = {"kind": "attitude", "at_s": 0.01, "euler_deg": [1.0, 0.0, 0.0]}  # the controller's own affair
    linked = Linked(step, {"kind": "controller_hung", "at_s": 0.02, "for_s": 0.012})
    assert stamps(linked.fly()) == [0, 1, 2, 3, 4, 4, 4, 4, *range(8, 20)]
    assert linked.events == ["controller_hung"]
    assert linked.counts("to_controller") == {"sent": 20, "arrived": 20, "unheard": 3}


@pytest.mark.parametrize("lockstep", [True, False])
def test_killed_controller_is_held_for_a_second_and_then_the_fail_safe_flies(lockstep):
    linked = Linked({"kind": "controller_killed", "at_s": 0.02}, samples=300, lockstep=lockstep)
    flown = linked.fly()
    torques = [setpoint for setpoint in flown if isinstance(setpoint, TorqueCommand)]
    holds = [setpoint for setpoint in flown if isinstance(setpoint, AttitudeTarget)]
    last_us = 4 * SAMPLE_US
    assert STALL_US == 50_000
    assert len(torques) in (17, 18)  # 50 ms = 12.5 samples after the last of five answers
    assert set(holds) == {AttitudeTarget(last_us, Counting.estimate_q_NB, omega_B=None, thrust=None)}
    assert linked.flight.counters[TimingFault.STALLED] == 1
    assert flown[: len(torques) + len(holds)] == torques + holds
    assert len(torques) + len(holds) in (254, 255)  # 1 s = 250 samples after the last of five answers
    assert linked.autopilot.in_fail_safe
    assert linked.counts("to_controller")["unheard"] == 295
    assert linked.flight.left_offboard


def rejoined(mode: Mode | None) -> tuple[Linked, list[int]]:
    """Kill a controller for 12 ms and let the next one answer once, in a mode; return the flight and wall times."""
    linked = Linked({"kind": "controller_killed", "at_s": 0.02, "recovers_after_s": 0.012})
    linked.fly(until=8)
    linked.asked.clear()
    waits: list[int] = []
    while linked.link.next_action(linked.now_us) is NextAction.RESEND:
        waits.append(linked.now_us)
        assert linked.link.next_action(linked.now_us) is NextAction.WAIT
        linked.now_us = linked.link.deadline_us()
        if len(waits) == 3:
            break
    if mode is not None:
        linked.autopilot.set_mode(mode)
        assert linked.link.offer(torque(8 * SAMPLE_US), SIZE, linked.stamp_us) is None
    return linked, waits


def test_time_stands_for_a_replacement_until_it_has_answered():
    linked, waits = rejoined(Mode.OFFBOARD)
    assert waits == [BEGIN_US, BEGIN_US + RESEND_US, BEGIN_US + 2 * RESEND_US]
    assert stamps(linked.fly()) == [0, 1, 2, 3, 4, 4, 4, 4, *range(8, 20)]
    assert linked.now_us == BEGIN_US + 3 * RESEND_US
    assert linked.counts("to_controller")["unheard"] == 3


def test_replacement_outside_offboard_is_waited_for_and_given_up():
    linked, _ = rejoined(Mode.STABILIZED)
    linked.fly()
    assert linked.now_us == BEGIN_US + JOIN_TIMEOUT_US
    assert linked.counts("to_controller")["unheard"] == 15  # all after the fifth


def test_answer_of_a_replacement_after_the_fail_safe_is_a_stream_again():
    linked = Linked({"kind": "controller_killed", "at_s": 0.02, "recovers_after_s": 1.5}, samples=400)
    linked.fly(until=380)
    assert linked.link.next_action(linked.now_us) is NextAction.RESEND
    assert linked.autopilot.set_mode(Mode.OFFBOARD) is TransitionResult.NO_STREAM
    assert linked.link.offer(torque(380 * SAMPLE_US), SIZE, linked.stamp_us) is None
    assert linked.autopilot.set_mode(Mode.OFFBOARD) is TransitionResult.ACCEPTED
    assert stamps(linked.fly()[380:]) == list(range(380, 400))


def test_replacement_that_never_comes_is_given_up():
    linked, _ = rejoined(None)
    linked.fly(silent)
    assert linked.now_us == BEGIN_US + JOIN_TIMEOUT_US
    assert linked.loop.sample == 20
    assert not linked.link.joining


def test_replacement_answers_only_the_sample_that_stands():
    linked, _ = rejoined(None)
    link = linked.link
    assert link.offer(torque(7 * SAMPLE_US), SIZE, linked.stamp_us) is RejectReason.STALE
    assert link.offer(torque(9 * SAMPLE_US), SIZE, linked.stamp_us) is RejectReason.EARLY
    assert link.next_action(linked.now_us) is NextAction.RESEND
    assert link.next_action(linked.now_us) is NextAction.WAIT


def test_controller_that_does_not_answer_is_asked_again_and_then_lost():
    linked = Linked(DELAYED, samples=300)
    linked.fly(until=10)
    assert linked.now_us == BEGIN_US
    linked.fly(silent)
    assert linked.now_us == BEGIN_US + (MAX_RESENDS + 1) * RESEND_US
    repeats = [stamp_us for _, stamp_us in linked.asked[-MAX_RESENDS - 1 :]]
    assert repeats == [8 * SAMPLE_US] * (MAX_RESENDS + 1)
    assert linked.autopilot.in_fail_safe
    assert linked.counts("to_controller")["unheard"] > 280


def test_lockstep_takes_one_answer_to_the_sample_that_was_sent():
    linked = Linked(DELAYED)
    link = linked.link
    assert link.offer(torque(0), SIZE, 0) is RejectReason.EARLY  # nothing has reached the controller
    linked.fly(until=2)
    assert link.next_action(linked.now_us) is NextAction.RESEND
    assert link.sample.time_us == 0
    assert link.offer(torque(SAMPLE_US), SIZE, linked.stamp_us) is RejectReason.EARLY
    assert link.offer(torque(0), SIZE, linked.stamp_us) is None
    assert link.offer(torque(0), SIZE, linked.stamp_us) is RejectReason.DUPLICATE
    linked.fly(until=3)
    assert link.next_action(linked.now_us) is NextAction.RESEND
    assert link.offer(torque(0), SIZE, linked.stamp_us) is RejectReason.STALE


@pytest.mark.parametrize("lockstep", [True, False])
def test_nothing_is_due_while_the_flight_is_paused(lockstep):
    linked = Linked(DELAYED, lockstep=lockstep)
    linked.fly(until=10)
    linked.flight.pause(linked.now_us, paused=True)
    assert linked.link.deadline_us() == NEVER_US
    assert linked.link.next_action(linked.now_us + 1_000_000) is NextAction.WAIT
    linked.now_us += 1_000_000
    linked.flight.pause(linked.now_us, paused=False)
    assert stamps(linked.fly())[2:] == list(range(18))
    assert linked.link.deadline_us() is None


def test_samples_in_real_time_wake_the_link_when_they_reach_the_controller():
    linked = Linked({**DELAYED, "delay_s": 0.005}, lockstep=False)
    assert linked.link.deadline_us() == BEGIN_US + SAMPLE_US
    linked.fly(until=1)
    assert linked.link.deadline_us() == BEGIN_US + 5_000
    linked.now_us = BEGIN_US + 4_999
    assert list(linked.link.take_deliveries(linked.stamp_us)) == []
    linked.now_us = BEGIN_US + 5_000
    assert [sample.time_us for sample in linked.link.take_deliveries(linked.stamp_us)] == [0]
    assert linked.link.deadline_us() == BEGIN_US + 2 * SAMPLE_US


def test_stamps_of_another_message_do_not_overtake_in_real_time():
    linked = Linked(DELAYED, lockstep=False)
    linked.fly(until=5)
    level = AttitudeTarget(time_us=1000, q_NB=(1.0, 0.0, 0.0, 0.0), omega_B=None, thrust=0.5)
    assert linked.link.offer(level, SIZE, linked.stamp_us) is None
    linked.fly(silent, until=7)
    assert linked.loop.flown[-1] == level
    assert "overtaken" not in linked.counts("to_vehicle")
