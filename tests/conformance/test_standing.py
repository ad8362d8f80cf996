"""A vehicle on the ground, a pilot at a ground station and a law, on one virtual clock: control and its transfer."""

import math
import struct
from collections.abc import Callable
from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.modes import LandedState, Mode
from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.config.waveforms import Constant
from firmware_model.mavlink.frames import RejectReason, parse
from firmware_model.session.pacing import TimingFault
from firmware_model.session.vehicle_endpoint import VehicleEndpoint
from gustproof.flight.endpoint.endpoint import ControllerEndpoint, Phase
from gustproof.law.form import load_law

VEHICLE, CONTROLLER, PILOT = (1, ("vehicle", 1)), (1, ("controller", 1)), (0, ("pilot", 1))
ARM, TAKEOFF, LAND = wire.MAV_CMD_COMPONENT_ARM_DISARM, wire.MAV_CMD_NAV_TAKEOFF, wire.MAV_CMD_NAV_LAND
SET_MODE = wire.MAV_CMD_DO_SET_MODE
OFFBOARD, AUTO, HOLD, RETURN = 6.0, 4.0, 3.0, 5.0
IMU, SETPOINT = wire.MAVLINK_MSG_ID_HIGHRES_IMU, wire.MAVLINK_MSG_ID_SET_ACTUATOR_CONTROL_TARGET
ASKED = {wire.MAVLINK_MSG_ID_HEARTBEAT, wire.MAVLINK_MSG_ID_COMMAND_ACK, wire.MAVLINK_MSG_ID_STATUSTEXT}
"""What the pilot reads: to decode all streams would take a third of the time."""
CALM = load_scenario("calm")
Tamper = Callable[[bytes], list[bytes]]


def untouched(datagram: bytes) -> list[bytes]:
    return [datagram]


class Airfield:
    """The vehicle in real time, a pilot, and a controller that may join; `up` alters the controller's datagrams."""

    def __init__(self, *, air: Scenario = CALM, free: bool = True) -> None:
        scenario = replace(air, translation="free" if free else "held")
        self.modes: list[float] = []
        self.vehicle = VehicleEndpoint(
            load_vehicle("paper"), scenario, 1, lambda row: self.modes.append(row[-1]), lockstep=False, interactive=True
        )
        self.controller: ControllerEndpoint | None = None
        self.up: Tamper = untouched
        self.now_us = 5_000_000
        self.station = wire.MAVLink(None, 255, 190)
        self.heard: list = []
        self.samples: list[int] = []
        self._heartbeat_at_us = 0

    @property
    def loop(self):
        return self.vehicle.loop

    @property
    def autopilot(self):
        return self.vehicle.autopilot

    @property
    def height(self) -> float:
        """[m] Above home."""
        return self.autopilot.home_N[2] - self.loop.true_vector("position_N")[2]

    @property
    def texts(self) -> list[str]:
        return [message.text for message in self.heard if message.get_type() == "STATUSTEXT"]

    def join(self, law: str = "hinf-scheduled") -> ControllerEndpoint:
        self.controller = ControllerEndpoint(load_law(law), VEHICLE)
        return self.controller

    def say(self, message) -> None:
        self.vehicle.receive(message.pack(self.station), PILOT, self.now_us)

    def order(self, command: int, *numbers: float) -> int:
        """Give a command as the pilot; return its result."""
        filled = (*numbers, *[math.nan] * (7 - len(numbers)))
        self.say(wire.MAVLink_command_long_message(1, 1, command, 0, *filled))
        self.run(0.004)
        return [message.result for message in self.heard if message.get_type() == "COMMAND_ACK"][-1]

    def run(self, seconds: float) -> None:
        end_us = self.now_us + round(seconds * 1e6)
        while self.now_us < end_us:
            self._exchange()
            deadlines = [self.vehicle.deadline_us(), self._heartbeat_at_us]
            if self.controller is not None and not self.controller.finished:
                deadlines.append(self.controller.deadline_us())
            self.now_us = min(max(self.now_us + 1, min(deadlines)), end_us)

    def until(self, reached: Callable[[], bool], seconds: float) -> None:
        for _ in range(round(10 * seconds)):
            if reached():
                return
            self.run(0.1)
        pytest.fail(f"not reached within {seconds} s, mode {self.autopilot.mode}, height {self.height}")

    def take_off(self, height: float = 10.0) -> None:
        assert self.order(ARM, 1.0) == wire.MAV_RESULT_ACCEPTED
        amsl = 488.0 - self.autopilot.home_N[2] + height
        assert self.order(TAKEOFF, math.nan, math.nan, math.nan, math.nan, math.nan, math.nan, amsl) == 0
        self.until(lambda: self.autopilot.mode is Mode.HOLD, 30.0)
        self.run(3.0)

    def _exchange(self) -> None:
        if self.now_us >= self._heartbeat_at_us:
            self._heartbeat_at_us = self.now_us + 1_000_000
            self.say(wire.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        for _ in range(4):  # question and answer, at no time at all
            sent = self.vehicle.poll(self.now_us)
            for datagram, peer in sent:
                if peer == PILOT:
                    self.heard += [frame.message() for frame in parse(datagram) if frame.message_id in ASKED]
                elif self.controller is not None and not self.controller.finished:
                    self.controller.receive(datagram, VEHICLE, self.now_us)
                    stamps = [frame.payload[:8] for frame in parse(datagram) if frame.message_id == IMU]
                    self.samples += [int.from_bytes(stamp, "little") for stamp in stamps]
            answers: list = []
            if self.controller is not None and not self.controller.finished:
                answers = self.controller.poll(self.now_us)
                for datagram, _ in answers:
                    for altered in self.up(datagram):
                        self.vehicle.receive(altered, CONTROLLER, self.now_us)
            if not sent and not answers:
                break


@pytest.fixture
def field() -> Airfield:
    return Airfield()


@pytest.fixture
def flown(field) -> Airfield:
    """A law one second after it took over a vehicle in hover."""
    field.take_off()
    field.join()
    field.until(lambda: field.autopilot.mode is Mode.OFFBOARD, 3.0)
    field.run(1.0)
    assert field.controller.phase is Phase.FLYING
    return field


def test_vehicle_takes_off_to_10_m_holds_lands_and_disarms(field):
    field.run(2.0)
    assert (field.autopilot.landed_state, field.height) == (LandedState.ON_GROUND, pytest.approx(0.0, abs=1e-6))
    field.take_off()
    assert field.height == pytest.approx(10.0, abs=0.3)
    assert field.autopilot.landed_state is LandedState.IN_AIR
    field.run(5.0)
    assert math.dist(field.loop.true_vector("position_N"), (0.0, 0.0, field.autopilot.home_N[2] - 10.0)) < 0.3
    assert field.order(LAND) == wire.MAV_RESULT_ACCEPTED
    assert field.autopilot.landed_state is LandedState.LANDING
    field.until(lambda: not field.autopilot.armed, 40.0)
    assert field.autopilot.landed_state is LandedState.ON_GROUND
    assert field.height == pytest.approx(0.0, abs=0.05)
    assert field.texts[-2:] == ["take-off height reached: HOLD", "landed: disarmed"]


def test_vehicle_takes_off_again_after_it_has_landed(field):
    for _ in range(2):
        field.take_off(5.0)
        field.order(LAND)
        field.until(lambda: not field.autopilot.armed, 40.0)


def test_return_comes_home_and_lands(field):
    field.take_off(5.0)
    field.order(SET_MODE, 1.0, 7.0)  # level: it keeps its drift
    field.run(5.0)
    assert field.order(SET_MODE, 1.0, AUTO, RETURN) == wire.MAV_RESULT_ACCEPTED
    field.until(lambda: not field.autopilot.armed, 90.0)
    north, east, _ = field.loop.true_vector("position_N")
    assert math.hypot(north, east) < 1.0


def test_level_flight_drifts_with_the_wind_and_hold_does_not():
    field = Airfield(air=replace(CALM, wind=(Constant(kind="constant", velocity_mps=(0.0, 4.0, 0.0)),)))
    field.take_off()
    assert abs(field.loop.true_vector("velocity_N")[1]) < 0.1
    field.order(SET_MODE, 1.0, 7.0)
    field.run(20.0)
    north, east, _ = field.loop.true_vector("position_N")
    assert east > 5.0  # blowing toward the east
    assert abs(north) < 0.5
    assert field.height == pytest.approx(10.0, abs=0.3)
    field.order(SET_MODE, 1.0, AUTO, HOLD)
    field.run(10.0)
    held = field.loop.true_vector("position_N")
    field.run(10.0)
    assert math.dist(field.loop.true_vector("position_N"), held) < 0.2


def test_disarming_in_the_air_is_refused_with_a_text_and_by_force_it_falls(field):
    field.take_off()
    assert field.order(ARM, 0.0) == wire.MAV_RESULT_TEMPORARILY_REJECTED
    assert field.texts[-1] == "in the air: land first, or force it"
    assert field.order(ARM, 0.0, 21196.0) == wire.MAV_RESULT_ACCEPTED
    field.run(1.0)
    assert field.height < 6.5  # g/2 s^2, less what the rotors still push


def test_law_takes_a_hovering_vehicle_and_is_announced_to_the_pilot(flown):
    assert "hinf-scheduled in control" in flown.texts
    seen = {(m.get_srcComponent(), m.type) for m in flown.heard if m.get_type() == "HEARTBEAT"}
    assert seen == {(1, 2), (191, 18)}
    flown.run(5.0)
    assert flown.autopilot.mode is Mode.OFFBOARD
    assert flown.height == pytest.approx(10.0, abs=0.5)
    assert not flown.vehicle.counters


def test_law_gets_each_sample_once(flown):
    flown.samples.clear()
    flown.run(2.0)
    steps = {b - a for a, b in zip(flown.samples, flown.samples[1:], strict=False)}
    assert steps == {4_000}
    assert len(flown.samples) in (500, 501)


def test_pilot_takes_the_vehicle_from_the_law_and_gives_it_back(flown):
    assert flown.order(SET_MODE, 1.0, AUTO, HOLD) == wire.MAV_RESULT_ACCEPTED
    flown.run(30.0)
    assert flown.autopilot.mode is Mode.HOLD
    assert flown.controller.phase is Phase.STANDING_BY
    assert flown.autopilot.is_stream_alive
    assert flown.order(SET_MODE, 1.0, OFFBOARD) == wire.MAV_RESULT_ACCEPTED
    flown.run(2.0)
    assert flown.autopilot.mode is Mode.OFFBOARD
    assert flown.controller.phase is Phase.FLYING
    assert flown.texts.count("hinf-scheduled in control") == 2
    assert flown.height == pytest.approx(10.0, abs=0.5)


def test_law_on_the_ground_stands_by_until_the_pilot_has_taken_off_and_gives_it(field):
    field.join()
    field.run(3.0)
    assert (field.autopilot.armed, field.autopilot.mode) == (False, Mode.STABILIZED)
    field.take_off()
    assert field.autopilot.mode is Mode.HOLD
    field.order(SET_MODE, 1.0, OFFBOARD)
    field.run(2.0)
    assert field.controller.phase is Phase.FLYING
    field.order(LAND)
    field.until(lambda: not field.autopilot.armed, 40.0)
    assert not field.controller.finished


@pytest.mark.parametrize(
    ("action", "mode", "text"),
    [(2, Mode.STABILIZED, "STABILIZED"), (4, Mode.LAND, "LAND"), (5, Mode.HOLD, "HOLD")],
)
def test_dead_law_leads_to_the_fail_safe_that_was_set(flown, action, mode, text):
    (bytewise,) = struct.unpack("<f", struct.pack("<i", action))
    flown.say(wire.MAVLink_param_set_message(1, 1, b"COM_OBL_RC_ACT", bytewise, wire.MAV_PARAM_TYPE_INT32))
    flown.up = lambda _: []
    flown.run(1.2)
    assert flown.autopilot.mode is mode
    assert f"set-points lost: failsafe {text}" in flown.texts
    # The stream comes back and is announced, but only the pilot can return control.
    flown.up = untouched
    flown.run(3.0)
    assert flown.autopilot.mode is mode
    assert "set-points are back: OFFBOARD may be set again" in flown.texts
    assert flown.order(SET_MODE, 1.0, OFFBOARD) == wire.MAV_RESULT_ACCEPTED
    flown.run(1.0)
    assert flown.controller.phase is Phase.FLYING


def kind(datagram: bytes) -> int:
    (frame,) = parse(datagram)
    return frame.message_id


def test_law_that_hangs_for_less_than_the_time_out_is_held_and_flies_on(flown):
    held = flown.vehicle.flight.counters[TimingFault.HELD]
    flown.up = lambda _: []
    flown.run(0.8)
    flown.up = untouched
    flown.run(1.0)
    assert flown.autopilot.mode is Mode.OFFBOARD
    assert 195 <= flown.vehicle.flight.counters[TimingFault.HELD] - held <= 205


def test_law_that_floods_flies_and_no_sample_is_late(flown):
    flown.up = lambda datagram: [datagram] * 50
    flown.run(1.0)
    assert flown.autopilot.mode is Mode.OFFBOARD
    assert flown.height == pytest.approx(10.0, abs=0.5)
    assert not flown.vehicle.flight.counters[TimingFault.OVERRUN]


def test_late_answers_fly_as_they_come(flown):
    waiting: list[bytes] = []

    def two_samples_late(datagram: bytes) -> list[bytes]:
        if kind(datagram) != SETPOINT:
            return [datagram]
        waiting.append(datagram)
        return [waiting.pop(0)] if len(waiting) > 2 else []

    flown.up = two_samples_late
    flown.run(2.0)
    assert flown.autopilot.mode is Mode.OFFBOARD
    assert not flown.vehicle.counters


def test_stale_stamps_are_counted_and_not_flown(flown):
    old: list[bytes] = []

    def old_one_after_each(datagram: bytes) -> list[bytes]:
        if kind(datagram) != SETPOINT:
            return [datagram]
        old.append(datagram)
        return [datagram, old[0]]

    flown.up = old_one_after_each
    flown.run(1.0)
    assert flown.autopilot.mode is Mode.OFFBOARD
    assert 245 <= flown.vehicle.counters[RejectReason.STALE] <= 255


def test_stamps_that_stay_behind_are_a_dead_stream(flown):
    old: list[bytes] = []

    def one_that_is_older_than_the_last(datagram: bytes) -> list[bytes]:
        if kind(datagram) != SETPOINT:
            return [datagram]
        old.append(datagram)
        return [old[0]] if len(old) > 2 else [datagram]

    flown.up = one_that_is_older_than_the_last
    flown.run(0.9)
    assert flown.autopilot.mode is Mode.OFFBOARD
    flown.run(0.2)
    assert flown.autopilot.mode is Mode.STABILIZED
    assert flown.vehicle.counters[RejectReason.STALE] > 240


def test_stand_is_clamped_until_armed_and_lands_by_levelling():
    stand = Airfield(air=load_scenario("paper"), free=False)
    stand.run(2.0)
    assert stand.loop.q_NB == (1.0, 0.0, 0.0, 0.0)
    assert stand.autopilot.landed_state is LandedState.ON_GROUND
    stand.join()
    stand.run(2.0)
    assert stand.order(ARM, 1.0) == wire.MAV_RESULT_ACCEPTED
    assert stand.order(SET_MODE, 1.0, OFFBOARD) == wire.MAV_RESULT_ACCEPTED
    stand.run(2.0)
    assert stand.autopilot.landed_state is LandedState.IN_AIR
    assert stand.loop.q_NB != (1.0, 0.0, 0.0, 0.0)
    assert stand.loop.true_vector("position_N") == (0.0, 0.0, -10.0)
    assert stand.order(SET_MODE, 1.0, AUTO, RETURN) == wire.MAV_RESULT_DENIED
    assert stand.texts[-1] == "held on the test stand: refused"
    stand.order(LAND)
    stand.until(lambda: not stand.autopilot.armed, 20.0)
    assert stand.autopilot.landed_state is LandedState.ON_GROUND


@pytest.mark.parametrize(
    ("mask", "q_NB", "rates", "gyro"),
    [
        (7, (math.cos(0.05), math.sin(0.05), 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),  # roll .1 rad
        (128, (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.4), (0.0, 0.0, 0.4)),  # as MAVSDK sends rates
        (3, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    ],
)
def test_set_points_of_the_pilots_own_program_are_flown(field, mask, q_NB, rates, gyro):
    def stream(seconds: float) -> None:
        for _ in range(round(20 * seconds)):
            message = wire.MAVLink_set_attitude_target_message(0, 1, 1, mask, list(q_NB), *rates, 0.5)
            field.say(message)
            field.run(0.05)

    field.take_off()
    assert field.order(SET_MODE, 1.0, OFFBOARD) == wire.MAV_RESULT_TEMPORARILY_REJECTED
    stream(0.5)
    assert field.order(SET_MODE, 1.0, OFFBOARD) == wire.MAV_RESULT_ACCEPTED
    stream(3.0)
    assert field.autopilot.mode is Mode.OFFBOARD
    assert field.loop.true_vector("omega_B") == pytest.approx(gyro, abs=0.02)
    if mask != 128:
        assert field.loop.q_NB == pytest.approx(q_NB, abs=0.01)
    field.run(1.5)
    assert field.autopilot.mode is Mode.STABILIZED


def test_second_stream_is_refused_while_the_first_is_alive_and_flies_after_it(flown):
    def stream() -> None:
        for _ in range(10):
            flown.say(wire.MAVLink_set_attitude_target_message(0, 1, 1, 7, [1.0, 0.0, 0.0, 0.0], 0, 0, 0, 0.5))
            flown.run(0.05)

    stream()
    assert flown.vehicle.counters[RejectReason.NOT_IN_COMMAND] == 10
    flown.up = lambda _: []
    flown.run(1.2)
    stream()
    assert flown.order(SET_MODE, 1.0, OFFBOARD) == wire.MAV_RESULT_ACCEPTED
    assert flown.vehicle.counters[RejectReason.NOT_IN_COMMAND] == 10
