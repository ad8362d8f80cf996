"""Both endpoints on one virtual clock, with a link between them that loses, repeats, delays and dies."""

import gc
import struct
from collections.abc import Callable
from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.modes import FailSafe, Mode
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.mavlink.frames import RejectReason, parse
from firmware_model.session.outcome import VehicleOutcome
from firmware_model.session.pacing import MAX_RESENDS, RESEND_US, TimingFault
from firmware_model.session.vehicle_endpoint import START_TIMEOUT_US, VehicleEndpoint
from gustproof.flight.endpoint.endpoint import ControllerEndpoint
from gustproof.flight.endpoint.endpoint import ControllerOutcome as ControllerOutcome
from gustproof.law.form import load_law

VEHICLE, CONTROLLER = (0, ("vehicle", 1)), (0, ("controller", 1))
SETPOINT, IMU = 139, 105
Tamper = Callable[[bytes, int], list[bytes]]


class Flight:
    """A flight of half a second in turbulence; `up` and `down` tamper with what controller and vehicle send."""

    def __init__(self, *, lockstep: bool = True, **changes) -> None:
        self.rows: list[bytes] = []
        self.modes: list[float] = []
        scenario = replace(load_scenario("paper-turbulence"), **{"duration_s": 0.5, **changes})
        self.vehicle = VehicleEndpoint(load_vehicle("paper"), scenario, 1, self.record, lockstep=lockstep)
        self.controller = ControllerEndpoint(load_law("hinf-d1"), VEHICLE)
        self.now_us = 0

    def record(self, row) -> None:
        self.rows.append(row.tobytes())
        self.modes.append(row[-1])

    def run(self, up: Tamper = lambda datagram, _: [datagram], down: Tamper = lambda datagram, _: [datagram]) -> None:
        steps = 0
        while not self.vehicle.finished:
            sent = self.vehicle.poll(self.now_us)
            for datagram in [datagram for datagram, peer in sent if peer == CONTROLLER]:
                for altered in down(datagram, len(self.rows)):
                    self.controller.receive(altered, VEHICLE, self.now_us)
            answers = [] if self.controller.finished else self.controller.poll(self.now_us)
            for datagram, _ in answers:
                for altered in up(datagram, len(self.rows)):
                    self.vehicle.receive(altered, CONTROLLER, self.now_us)
            if not sent and not answers:
                deadlines = [self.vehicle.deadline_us()]
                deadlines += [] if self.controller.finished else [self.controller.deadline_us()]
                self.now_us = max(self.now_us + 1, min(deadlines))
            steps += 1
            assert steps < 100_000, "the flight hangs"

    @property
    def counters(self) -> dict:
        return dict(self.vehicle.counters) | dict(self.vehicle.flight.counters)


def kind(datagram: bytes) -> int:
    (frame,) = parse(datagram)
    return frame.message_id


@pytest.fixture(scope="module")
def clean() -> Flight:
    flight = Flight()
    flight.run()
    return flight


def test_clean_flight_is_flown_to_the_end_by_the_law(clean):
    assert clean.vehicle.outcome is VehicleOutcome.DONE
    assert clean.controller.outcome is ControllerOutcome.DONE
    assert len(clean.rows) == 125
    assert set(clean.modes) == {Mode.OFFBOARD.value}
    assert clean.counters == {}


def test_a_flight_leaves_no_cycles_as_its_processes_do_without_the_collector(clean):
    flight = Flight()
    while gc.collect():  # cycles of earlier tests may hold others, which the next collection finds
        pass
    gc.disable()
    try:
        flight.run()
        assert gc.collect() == 0
    finally:
        gc.enable()


def test_lost_samples_are_sent_again_and_change_no_bit(clean):
    flight, sent = Flight(), []

    def lose_every_third_sample(datagram, _):
        if kind(datagram) != IMU:
            return [datagram]
        sent.append(datagram)
        return [] if len(sent) % 3 == 0 else [datagram]

    flight.run(down=lose_every_third_sample)
    assert flight.vehicle.outcome is VehicleOutcome.DONE
    assert flight.rows == clean.rows
    assert flight.counters[TimingFault.RESENT] > 30


def test_lost_answers_are_repeated_by_the_law_without_a_step(clean):
    flight, sent = Flight(), []

    def lose_every_third_answer(datagram, _):
        if kind(datagram) != SETPOINT:
            return [datagram]
        sent.append(datagram)
        return [] if len(sent) % 3 == 0 else [datagram]

    flight.run(up=lose_every_third_answer)
    assert flight.vehicle.outcome is VehicleOutcome.DONE
    assert flight.rows == clean.rows


def test_doubled_answers_are_counted_and_change_no_bit(clean):
    flight = Flight()
    flight.run(up=lambda datagram, _: [datagram, datagram] if kind(datagram) == SETPOINT else [datagram])
    assert flight.rows == clean.rows
    assert flight.counters[RejectReason.DUPLICATE] >= 124


def test_late_answers_are_stale_and_change_no_bit(clean):
    flight, late = Flight(), []

    def and_the_one_of_two_before(datagram, _):
        if kind(datagram) != SETPOINT:
            return [datagram]
        late.append(datagram)
        return [late[-3], datagram] if len(late) > 3 else [datagram]

    flight.run(up=and_the_one_of_two_before)
    assert flight.rows == clean.rows
    assert flight.counters[RejectReason.STALE] > 100


def test_answer_to_a_sample_that_was_not_sent_is_early(clean):
    flight, answers = Flight(), list[bytes]()
    Flight().run(up=lambda datagram, _: answers.append(datagram) or [datagram])
    future = [datagram for datagram in answers if kind(datagram) == SETPOINT][-1]
    flight.run(up=lambda datagram, _: [future, datagram] if kind(datagram) == SETPOINT else [datagram])
    assert flight.rows == clean.rows
    assert flight.counters[RejectReason.EARLY] > 100


def test_dead_controller_ends_in_the_fail_safe_after_the_stated_resends(clean):
    flight = Flight()
    flight.run(up=lambda datagram, flown: [datagram] if flown < 50 else [])
    assert flight.vehicle.outcome is VehicleOutcome.STREAM_LOST
    assert flight.counters[TimingFault.RESENT] == MAX_RESENDS
    assert len(flight.rows) == 125
    assert flight.rows[:50] == clean.rows[:50]
    assert flight.modes == [Mode.OFFBOARD.value] * 50 + [Mode.STABILIZED.value] * 75
    # One waiting time for the first sending and one for each repetition; the margin covers a heartbeat.
    assert flight.now_us < (MAX_RESENDS + 1) * RESEND_US + 2_000_000


def test_controller_hears_that_offboard_is_lost():
    flight = Flight()
    flight.run(up=lambda datagram, flown: [datagram] if flown < 50 else [])
    assert flight.controller.outcome in (ControllerOutcome.MODE_LOST, ControllerOutcome.DONE)
    assert Mode.STABILIZED.value in flight.modes


def test_damaged_answers_are_counted_and_asked_for_again(clean):
    flight, sent = Flight(), []

    def damage_every_fourth(datagram, _):
        sent.append(datagram)
        return [datagram[:-1] + bytes([datagram[-1] ^ 1])] if len(sent) % 4 == 0 else [datagram]

    flight.run(up=damage_every_fourth)
    assert flight.vehicle.outcome is VehicleOutcome.DONE
    assert flight.rows == clean.rows
    assert flight.counters[RejectReason.BAD_CHECKSUM] > 30


def test_flight_that_nobody_begins_ends_with_a_name():
    flight = Flight()
    flight.run(up=lambda *_: [])
    assert flight.vehicle.outcome is VehicleOutcome.NO_CONTROLLER
    assert flight.rows == []
    assert flight.now_us <= START_TIMEOUT_US + 2_000_000


def test_dead_autopilot_is_noticed_by_the_controller():
    flight = Flight()
    flight.run(down=lambda datagram, flown: [datagram] if flown < 50 else [])
    assert flight.vehicle.outcome is VehicleOutcome.STREAM_LOST  # it cannot know that its datagrams are lost
    while not flight.controller.finished:
        flight.now_us = max(flight.now_us + 1, flight.controller.deadline_us())
        flight.controller.poll(flight.now_us)
    assert flight.controller.outcome is ControllerOutcome.AUTOPILOT_LOST


def test_real_time_on_a_virtual_clock_flies_the_same_bits(clean):
    flight = Flight(lockstep=False)
    flight.run()
    assert flight.vehicle.outcome is VehicleOutcome.DONE
    assert flight.rows == clean.rows


def test_flight_that_was_taken_and_given_back_is_not_called_the_laws_own():
    flight, pilot = Flight(lockstep=False), wire.MAVLink(None, 255, 190)

    def ask_for_another_mode_and_back(datagram: bytes, flown: int) -> list[bytes]:
        mode = {30: (4, 3), 60: (6, 0)}.get(flown)
        if mode is None:
            return [datagram]
        return [datagram, wire.MAVLink_command_long_message(1, 1, 176, 0, 1, *mode, 0, 0, 0, 0).pack(pilot)]

    flight.run(up=ask_for_another_mode_and_back)
    assert set(flight.modes[:30] + flight.modes[61:]) == {Mode.OFFBOARD.value}
    assert set(flight.modes[31:60]) == {Mode.HOLD.value}
    assert flight.vehicle.outcome is VehicleOutcome.LEFT_OFFBOARD
    assert flight.controller.outcome is ControllerOutcome.DONE


@pytest.mark.parametrize("lockstep", [True, False])
def test_flood_of_answers_changes_no_bit(clean, lockstep):
    flight = Flight(lockstep=lockstep)
    flight.run(up=lambda datagram, _: [datagram] * 40 if kind(datagram) == SETPOINT else [datagram])
    assert flight.rows == clean.rows
    assert flight.counters.get(RejectReason.DUPLICATE, 0) >= (39 * 124 if lockstep else 0)


def test_hung_controller_is_waited_for_in_lockstep(clean):
    flight, silent_until_us = Flight(), 0

    def hang_for_two_seconds(datagram: bytes, flown: int) -> list[bytes]:
        nonlocal silent_until_us
        if flown == 50 and not silent_until_us:
            silent_until_us = flight.now_us + 2_000_000
        return [] if flight.now_us < silent_until_us else [datagram]

    flight.run(up=hang_for_two_seconds)
    assert flight.vehicle.outcome is VehicleOutcome.DONE
    assert flight.rows == clean.rows
    assert flight.counters[TimingFault.RESENT] == 2_000_000 // RESEND_US


def test_free_flight_whose_law_dies_lands_if_so_set_and_ends_before_its_script():
    flight = Flight(lockstep=False, duration_s=120.0, translation="free", altitude_m=3.0, wind=())
    flight.vehicle.autopilot.settings = replace(flight.vehicle.autopilot.settings, fail_safe=FailSafe.LAND)
    flight.run(up=lambda datagram, flown: [datagram] if flown < 250 else [])
    assert flight.vehicle.outcome is VehicleOutcome.STREAM_LOST
    assert set(flight.modes[:499]) == {Mode.OFFBOARD.value}
    assert set(flight.modes[500:-1]) == {Mode.LAND.value}
    assert len(flight.rows) < 30 * 250
    assert flight.vehicle.loop.on_ground
    assert not flight.vehicle.autopilot.armed


def test_flight_paused_by_a_parameter_is_the_same_to_the_bit(clean):
    flight, watcher, packer = Flight(), (0, ("watcher", 2)), wire.MAVLink(None, 255, 190)
    heard: list[int] = []

    def pause(paused: int) -> None:
        (value,) = struct.unpack("<f", struct.pack("<i", paused))
        message = wire.MAVLink_param_set_message(1, 1, b"GP_PAUSE", value, wire.MAV_PARAM_TYPE_INT32)
        flight.vehicle.receive(message.pack(packer), watcher, flight.now_us)

    def down(datagram: bytes, flown: int) -> list[bytes]:
        if kind(datagram) == IMU and flown == 60 and not heard:
            pause(1)
        elif kind(datagram) == wire.MAVLINK_MSG_ID_HEARTBEAT and flown >= 60:
            heard.append(flown)
            if len(heard) == 20:
                pause(0)
        return [datagram]

    flight.run(down=down)
    assert set(heard[:20]) == {60}
    assert flight.now_us > 10_000_000
    assert flight.rows == clean.rows
    assert flight.counters == {}
