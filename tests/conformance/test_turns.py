"""The fast path of lockstep sends the same bytes as the step-by-step path."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as wire

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.mavlink import messages
from firmware_model.mavlink.frames import parse
from firmware_model.session.outcome import VehicleOutcome
from firmware_model.session.vehicle_endpoint import VehicleEndpoint
from firmware_model.types import AttitudeTarget, ImuSample, TorqueCommand
from gustproof.flight.endpoint.endpoint import ControllerEndpoint
from gustproof.law.form import load_law

VEHICLE, CONTROLLER, STATION = (0, ("vehicle", 1)), (0, ("controller", 1)), (0, ("station", 1))
float32 = st.floats(-1.0, 1.0, width=32)
vectors = st.tuples(float32, float32, float32)
sequences = st.integers(0, 255)


def packer(component: int, sequence: int) -> wire.MAVLink:
    packer = wire.MAVLink(None, 1, component)
    packer.seq = sequence
    return packer


@given(st.integers(0, 2**62), vectors, vectors, sequences)
def test_sample_made_at_once_is_the_one_of_pymavlink_and_read_as_usual(time_us, force, rate, sequence):
    datagram = messages.imu_template(1).make(sequence, time_us, *force, *rate)
    unmeasured = [0.0] * 7
    message = wire.MAVLink_highres_imu_message(time_us, *force, *rate, *unmeasured, 0x3F)
    assert datagram == message.pack(packer(1, sequence))
    assert messages.imu_template(1).read(datagram, sequence) == (time_us, *force, *rate)
    assert messages.parse_imu(parse(datagram)[0]) == ImuSample(time_us, rate, force)


@given(st.integers(0, 2**62), vectors, sequences)
def test_torques_made_at_once_are_those_of_pymavlink_and_read_as_usual(time_us, torque, sequence):
    datagram = messages.torque_template(1).make(sequence, time_us, *torque, math.nan)
    message = wire.MAVLink_set_actuator_control_target_message(
        time_us, 0, 1, 1, (*torque, math.nan, 0.0, 0.0, 0.0, 0.0)
    )
    assert datagram == message.pack(packer(191, sequence))
    assert messages.torque_template(1).read(datagram, sequence)[:4] == (time_us, *torque)
    assert messages.parse_command(parse(datagram)[0], 1) == TorqueCommand(time_us, torque, None)


@given(st.integers(0, 2**32 - 1), vectors, st.floats(0.0, 1.0, width=32), sequences)
def test_rates_made_at_once_are_those_of_pymavlink_and_read_as_usual(time_ms, rate, thrust, sequence):
    datagram = messages.rate_template(1).make(sequence, time_ms, *rate, thrust)
    message = wire.MAVLink_set_attitude_target_message(time_ms, 1, 1, 128, (0.0, 0.0, 0.0, 0.0), *rate, thrust)
    assert datagram == message.pack(packer(191, sequence))
    assert messages.rate_template(1).read(datagram, sequence) == (time_ms, *rate, thrust)
    assert messages.parse_command(parse(datagram)[0], 1) == AttitudeTarget(time_ms * 1000, None, rate, thrust)


@pytest.mark.parametrize(
    ("series", "changing"),
    [(messages.imu_template(1), 6), (messages.torque_template(1), 4), (messages.rate_template(1), 4)],
)
def test_what_differs_by_a_bit_or_a_byte_or_in_its_number_is_not_read_at_once(series, changing):
    datagram = series.make(7, 4000, *[0.5] * changing)
    assert series.read(datagram, 7) is not None
    assert series.read(datagram, 8) is None
    for end in range(len(datagram)):
        assert series.read(datagram[:end], 7) is None
    for extra in (b"\0", b"1", datagram):
        assert series.read(datagram + extra, 7) is None
    number = int.from_bytes(datagram, "little")
    for bit in range(8 * len(datagram)):
        assert series.read((number ^ 1 << bit).to_bytes(len(datagram), "little"), 7) is None


ALTERED = {60: (1.5, (0,)), 80: (-0.5, (3,)), 120: (math.nan, (1,))}


def altered(datagram: bytes, value: float, fields: tuple[int, ...]) -> bytes:
    """Return a set-point with other fields behind its stamp, and anything else unchanged."""
    (frame,) = parse(datagram)
    series = {139: messages.torque_template(1), 82: messages.rate_template(1)}.get(frame.message_id)
    values = series.read(datagram, frame.sequence) if series else None
    if values is None:
        return datagram
    stamp, *rest = values
    return series.make(frame.sequence, stamp, *[value if i in fields else rest[i] for i in range(len(rest))])


class Pair:
    """A flight of a second; of the datagrams each way one is lost, and one is doubled; three set-points are odd."""

    def __init__(self, law: str, *, watched: bool) -> None:
        self.rows: list[bytes] = []
        self.said: list[tuple[bytes, tuple]] = []
        scenario = replace(load_scenario("paper-turbulence"), duration_s=1.0)
        self.vehicle = VehicleEndpoint(
            load_vehicle("paper"), scenario, 1, lambda row: self.rows.append(row.tobytes()), lockstep=True
        )
        self.controller = ControllerEndpoint(load_law(law), VEHICLE)
        self.now_us = 0
        self.counts = {"down": 0, "up": 0}
        if watched:
            heartbeat = wire.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
            self.vehicle.receive(heartbeat.pack(wire.MAVLink(None, 255, 190)), STATION, 0)
        while not self.vehicle.finished:
            self._go_on()

    def _go_on(self) -> None:
        down = self.vehicle.poll(self.now_us)
        for datagram in self._carried(down, "down"):
            self.controller.receive(datagram, VEHICLE, self.now_us)
        up = self.controller.poll(self.now_us)
        for datagram in self._carried([(datagram, CONTROLLER) for datagram, _ in up], "up"):
            self.vehicle.receive(datagram, CONTROLLER, self.now_us)
        self.now_us += 10
        if not (down or up):
            self.now_us = min(self.vehicle.deadline_us(), self.controller.deadline_us())

    def _carried(self, sent: list[tuple[bytes, tuple]], way: str) -> list[bytes]:
        carried = []
        for datagram, peer in sent:
            self.said.append((datagram, peer))
            if peer == CONTROLLER:
                self.counts[way] += 1
                changed = altered(datagram, *ALTERED.get(self.counts[way], (0.0, ()))) if way == "up" else datagram
                carried += [changed] * {100: 0, 170: 2}.get(self.counts[way], 1)
        return carried

    @property
    def figures(self) -> tuple:
        return (
            self.vehicle.links,
            self.controller.channel.stats(),
            self.vehicle.counters,
            self.vehicle.flight.counters,
        )


@pytest.mark.parametrize("watched", [False, True])
@pytest.mark.parametrize("law", ["hinf-scheduled", "hinf-rates"])
def test_turns_leave_every_datagram_record_and_figure_as_they_are_step_by_step(law, watched, monkeypatch):
    taken = []
    step = VehicleEndpoint._step_lockstep
    monkeypatch.setattr(
        VehicleEndpoint, "_step_lockstep", lambda *arguments: taken.append(step(*arguments)) or taken[-1]
    )
    at_once = Pair(law, watched=watched)
    monkeypatch.setattr(VehicleEndpoint, "_step_lockstep", lambda *_: False)
    monkeypatch.setattr(ControllerEndpoint, "_answer_fast", lambda *_: False)
    step_by_step = Pair(law, watched=watched)
    assert at_once.vehicle.outcome is step_by_step.vehicle.outcome is VehicleOutcome.DONE
    assert at_once.rows == step_by_step.rows
    assert at_once.said == step_by_step.said
    assert at_once.figures == step_by_step.figures
    turns = sum(taken)
    assert turns > 100 if watched else turns > 240
