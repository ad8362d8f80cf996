"""The ground station against the vehicle itself, on a virtual clock."""

from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.parameters import GUST_SCALE_NAME, PAUSE_NAME
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.mavlink.frames import RejectReason, parse
from firmware_model.session.vehicle_endpoint import VehicleEndpoint
from gustproof.show.live.ground_station import GroundStation
from gustproof.show.live.telemetry_buffer import TelemetryBuffer

VEHICLE, STATION = (0, ("vehicle", 1)), (0, ("station", 2))


class Watched:
    """A vehicle that stands in turbulence, and a station that watches it."""

    def __init__(self, *, streams: bool = True) -> None:
        scenario = replace(load_scenario("paper-turbulence"), translation="free", physics_rate_hz=500)
        self.vehicle = VehicleEndpoint(
            load_vehicle("paper"), scenario, 1, lambda _: None, lockstep=False, interactive=True
        )
        self.feed = TelemetryBuffer(texts=[])
        self.reader = self.feed.reader()
        self.station = GroundStation(VEHICLE, self.feed, (10.0, 10.0, 10.0), streams=streams)
        self.now_us = 5_000_000
        self.heard: list[int] = []
        self.deaf = False

    def run(self, duration_us: int) -> None:
        end_us = self.now_us + duration_us
        while self.now_us < end_us:
            for datagram, _ in self.station.poll(self.now_us):
                if not self.deaf:
                    self.vehicle.receive(datagram, STATION, self.now_us)
            for datagram, _ in self.vehicle.poll(self.now_us):
                self.heard += [frame.message_id for frame in parse(datagram) if not isinstance(frame, RejectReason)]
                self.station.receive(datagram, VEHICLE, self.now_us)
            self.now_us += 4_000


@pytest.fixture
def watched() -> Watched:
    return Watched()


def test_station_is_told_attitude_and_wind_fifty_times_a_second_and_little_else(watched):
    watched.run(3_000_000)
    watched.reader.read()
    watched.heard.clear()
    watched.run(2_000_000)
    news = watched.reader.read()
    assert len(news["attitude"]) == pytest.approx(100, abs=2)
    assert len(news["wind"]) == pytest.approx(100, abs=2)
    unwanted = [number for number in watched.heard if number in (30, 31, 36, 83, 105, 375)]
    assert unwanted == []
    assert len(watched.heard) < 230


def test_what_was_sent_before_the_end_is_heard_before_it_finishes(watched):
    watched.run(1_000_000)
    watched.station.end()
    told = wire.MAVLink_statustext_message(6, b"landed").pack(wire.MAVLink(None, 1, 1))
    for _ in range(3):
        watched.station.poll(watched.now_us)
        assert not watched.station.finished
        watched.station.receive(told, VEHICLE, watched.now_us)
    watched.station.poll(watched.now_us)
    assert not watched.station.finished
    watched.station.poll(watched.now_us)
    assert watched.station.finished
    assert watched.feed["texts"][-3:] == ["landed"] * 3


def test_rows_are_the_truth_at_their_time(watched):
    watched.run(1_500_000)
    time_s, *numbers = watched.reader.read()["attitude"][-1]
    assert time_s == pytest.approx(watched.vehicle.loop.time_us * 1e-6, abs=0.03)
    assert numbers[:4] == pytest.approx(watched.vehicle.loop.q_NB, abs=1e-4)


def test_torque_that_is_held_is_told_as_held(watched):
    packer = wire.MAVLink(None, 1, 1)

    def tell(time_us: int, stamp_us: int, roll: float) -> None:
        state = wire.MAVLink_hil_state_quaternion_message(time_us, [1.0, 0.0, 0.0, 0.0], *[0] * 14)
        torque = wire.MAVLink_actuator_control_target_message(stamp_us, 0, [roll, *[0.0] * 7])
        watched.station.receive(state.pack(packer) + torque.pack(packer), VEHICLE, watched.now_us)

    tell(20_000, 20_000, 0.25)
    tell(40_000, 20_000, 0.25)
    tell(60_000, 60_000, 0.5)
    tell(60_000, 60_000, 0.75)  # before t = 0 a sample repeats
    rows = watched.reader.read()["torque"]
    assert [row[:2] for row in rows] == [[0.02, 2.5], [0.04, 2.5], [0.06, 5.0]]


def test_mode_and_link_are_told(watched):
    watched.run(2_500_000)
    facts = watched.reader.read()["facts"]
    assert (facts["mode"], facts["armed"]) == ("STABILIZED", False)
    assert (facts["gust_scale"], facts["paused"]) == (1.0, False)
    assert (facts["link"]["lost"], facts["link"]["bad"]) == (0, 0)
    assert facts["link"]["rate"] > 90
    assert facts["link"]["round_trip_ms"] >= 0.0


def test_wishes_are_repeated_until_the_vehicle_has_taken_them(watched):
    watched.run(1_000_000)
    assert watched.station.parameters_confirmed.is_set()
    watched.deaf = True
    watched.station.set_parameter(GUST_SCALE_NAME, 2.5)
    watched.run(1_000_000)
    assert not watched.station.parameters_confirmed.is_set()
    assert watched.vehicle.parameters[GUST_SCALE_NAME] == 1.0
    watched.deaf = False
    watched.run(500_000)
    assert watched.station.parameters_confirmed.is_set()
    assert watched.vehicle.parameters[GUST_SCALE_NAME] == 2.5
    assert watched.reader.read()["facts"]["gust_scale"] == 2.5


def test_pause_stands_and_goes_on(watched):
    watched.run(300_000)
    for paused in (1.0, 0.0):
        watched.station.set_parameter(PAUSE_NAME, paused)
        watched.run(200_000)
        assert watched.feed["paused"] is bool(paused)
        before = watched.vehicle.loop.sample
        watched.run(400_000)
        assert watched.vehicle.loop.sample - before == (0 if paused else 100)


def test_refused_wish_is_given_up(watched):
    watched.run(300_000)
    watched.station.set_parameter(GUST_SCALE_NAME, 7.0)
    watched.run(300_000)
    assert watched.station.parameters_confirmed.is_set()
    assert watched.vehicle.parameters[GUST_SCALE_NAME] == 1.0
    assert any("out of range" in text for text in watched.feed["texts"])


def test_in_lockstep_it_asks_for_no_stream_at_all():
    watched = Watched(streams=False)
    watched.run(4_000_000)
    watched.heard.clear()
    watched.run(3_000_000)
    assert "attitude" not in watched.reader.read()
    kept = {wire.MAVLINK_MSG_ID_HEARTBEAT, wire.MAVLINK_MSG_ID_TIMESYNC, wire.MAVLINK_MSG_ID_COMMAND_ACK}
    assert set(watched.heard) <= kept
    assert len(watched.heard) < 12


class Alone:
    """A station to which the test speaks in the vehicle's place."""

    def __init__(self) -> None:
        self.buffer = TelemetryBuffer(texts=[])
        self.station = GroundStation(VEHICLE, self.buffer, (10.0, 10.0, 10.0), streams=True)
        self.say(wire.MAVLink_heartbeat_message(2, 12, 1, 0, 4, 3))
        self.hear()

    def say(self, *messages, now_us: int = 0, component: int = 1) -> None:
        for message in messages:
            self.station.receive(message.pack(wire.MAVLink(None, 1, component)), VEHICLE, now_us)

    def hear(self, now_us: int = 0) -> list:
        return [frame.message() for datagram, _ in self.station.poll(now_us) for frame in parse(datagram)]


def test_it_finishes_once_nothing_more_comes_after_the_end():
    alone = Alone()
    alone.station.end()
    for _ in range(2):
        alone.say(wire.MAVLink_statustext_message(6, b"landed"))
        alone.hear(4000)
        assert not alone.station.finished
    assert alone.station.deadline_us() == 4000 + 20_000
    alone.hear(8000)
    assert alone.station.finished
    assert alone.buffer["texts"] == ["landed"] * 2


def test_stream_that_is_not_shown_is_stopped_at_most_once_a_second():
    alone, unwanted = Alone(), wire.MAVLink_attitude_message(0, *[0.0] * 6)
    for now_us, stops in ((0, 1), (999_999, 0), (1_000_000, 1)):
        alone.say(unwanted, unwanted, now_us=now_us)
        requests = [message for message in alone.hear(now_us) if message.get_type() == "COMMAND_LONG"]
        stopped = [request.param1 for request in requests if request.param2 == -1.0]
        assert stopped == [wire.MAVLINK_MSG_ID_ATTITUDE] * stops


def test_of_other_components_only_texts_are_shown():
    alone = Alone()
    alone.say(wire.MAVLink_heartbeat_message(18, 8, 128, 6, 4, 3), component=191)
    alone.say(wire.MAVLink_statustext_message(6, b"in control"), component=191)
    assert (alone.buffer["mode"], alone.buffer["armed"]) == ("0", False)
    assert alone.buffer["texts"] == ["in control"]


def test_wish_stands_until_its_parameter_has_the_value():
    alone = Alone()
    alone.station.set_parameter(GUST_SCALE_NAME, 2.0)
    (wish,) = alone.hear()
    assert (wish.param_id, wish.param_value) == (GUST_SCALE_NAME, 2.0)
    for name, value, is_confirmed in (
        ("OTHER", 2.0, False),
        (GUST_SCALE_NAME, 1.0, False),
        (GUST_SCALE_NAME, 2.0, True),
    ):
        alone.say(wire.MAVLink_param_value_message(name.encode(), value, 9, 2, 0))
        assert alone.station.parameters_confirmed.is_set() is is_confirmed
    assert alone.buffer["gust_scale"] == 2.0
    assert set(alone.buffer.reader().read()["facts"]) == {"texts", "mode", "armed", "link", "gust_scale"}


@pytest.mark.parametrize("datagram", [b"", b"\xfd", b"\xfe" * 40, bytes(300)])
def test_rubbish_is_counted_and_nothing_else(watched, datagram):
    watched.run(100_000)
    watched.station.receive(datagram, VEHICLE, watched.now_us)
    watched.station.receive(datagram, (0, ("stranger", 3)), watched.now_us)
    assert sum(watched.station.channel.dropped.values()) == (2 if datagram else 0)


def test_stranger_is_not_listened_to(watched):
    watched.run(100_000)
    packer = wire.MAVLink(None, 1, 1)
    text = wire.MAVLink_statustext_message(6, b"all is well").pack(packer)
    watched.station.receive(text, (0, ("stranger", 3)), watched.now_us)
    assert "all is well" not in watched.feed["texts"]
    watched.station.receive(text, VEHICLE, watched.now_us)
    assert "all is well" in watched.feed["texts"]
