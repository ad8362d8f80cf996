"""Lockstep in machine code sends the same bytes as step by step, and those of pymavlink."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as wire

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.mavlink import messages
from firmware_model.mavlink.frames import FrameTemplate, parse
from firmware_model.mavlink.wire import is_expected, read_stamp
from firmware_model.session.outcome import VehicleOutcome
from firmware_model.session.vehicle_endpoint import VehicleEndpoint
from firmware_model.types import AttitudeTarget, ImuSample, TorqueCommand
from gustproof.flight.endpoint.endpoint import ControllerEndpoint
from gustproof.flight.routes.loopback import _exchange
from gustproof.law.form import load_law

VEHICLE, CONTROLLER, STATION = (0, ("vehicle", 1)), (0, ("controller", 1)), (0, ("station", 1))
float32 = st.floats(-1.0, 1.0, width=32)
vectors = st.tuples(float32, float32, float32)
sequences = st.integers(0, 255)


def packer(component: int, sequence: int) -> wire.MAVLink:
    packer = wire.MAVLink(None, 1, component)
    packer.seq = sequence
    return packer


def read(template: FrameTemplate, datagram: bytes, sequence: int) -> tuple | None:
    """Return stamp and numbers of a frame as kernels read it; `None` if it is not the expected one."""
    wire = template.buffer()
    wire.frame[: len(datagram)] = np.frombuffer(datagram, dtype=np.uint8)
    return (read_stamp(wire), *wire.values.tolist()) if is_expected(wire, len(datagram), sequence) else None


@given(st.integers(0, 2**62), vectors, vectors, sequences)
def test_sample_made_at_once_is_the_one_of_pymavlink_and_read_as_usual(time_us, force, rate, sequence):
    datagram = messages.imu_template(1).make(sequence, time_us, *force, *rate)
    unmeasured = [0.0] * 7
    message = wire.MAVLink_highres_imu_message(time_us, *force, *rate, *unmeasured, 0x3F)
    assert datagram == message.pack(packer(1, sequence))
    assert read(messages.imu_template(1), datagram, sequence) == (time_us, *force, *rate)
    assert messages.parse_imu(parse(datagram)[0]) == ImuSample(time_us, rate, force)


@given(st.integers(0, 2**62), vectors, sequences)
def test_torques_made_at_once_are_those_of_pymavlink_and_read_as_usual(time_us, torque, sequence):
    datagram = messages.torque_template(1).make(sequence, time_us, *torque, math.nan)
    message = wire.MAVLink_set_actuator_control_target_message(
        time_us, 0, 1, 1, (*torque, math.nan, 0.0, 0.0, 0.0, 0.0)
    )
    assert datagram == message.pack(packer(191, sequence))
    assert read(messages.torque_template(1), datagram, sequence)[:4] == (time_us, *torque)
    assert messages.parse_command(parse(datagram)[0], 1) == TorqueCommand(time_us, torque, None)


@given(st.integers(0, 2**32 - 1), vectors, st.floats(0.0, 1.0, width=32), sequences)
def test_rates_made_at_once_are_those_of_pymavlink_and_read_as_usual(time_ms, rate, thrust, sequence):
    datagram = messages.rate_template(1).make(sequence, time_ms, *rate, thrust)
    message = wire.MAVLink_set_attitude_target_message(time_ms, 1, 1, 128, (0.0, 0.0, 0.0, 0.0), *rate, thrust)
    assert datagram == message.pack(packer(191, sequence))
    assert read(messages.rate_template(1), datagram, sequence) == (time_ms, *rate, thrust)
    assert messages.parse_command(parse(datagram)[0], 1) == AttitudeTarget(time_ms * 1000, None, rate, thrust)


ALTERED = {60: (1.5, (0,)), 80: (-0.5, (3,)), 120: (math.nan, (1,))}


def altered(datagram: bytes, value: float, fields: tuple[int, ...]) -> bytes:
    """Return a set-point with other fields behind its stamp, and anything else unchanged."""
    (frame,) = parse(datagram)
    series = {139: messages.torque_template(1), 82: messages.rate_template(1)}.get(frame.message_id)
    values = read(series, datagram, frame.sequence) if series else None
    if values is None:
        return datagram
    stamp, *rest = values
    return series.make(frame.sequence, stamp, *[value if i in fields else rest[i] for i in range(len(rest))])


class Pair:
    """A flight of a second; of the datagrams each way one is lost, and one is doubled; three set-points are odd."""

    def __init__(self, law: str, *, watched: bool, at_once: bool) -> None:
        self.at_once, self.turns = at_once, 0
        self.rows: list[bytes] = []
        self.said: list[tuple[bytes, tuple]] = []
        scenario = replace(load_scenario("paper-turbulence"), duration_s=1.0)
        self.vehicle = VehicleEndpoint(
            load_vehicle("paper"),
            scenario,
            1,
            lambda records: self.rows.extend(row.tobytes() for row in np.atleast_2d(records)),
            lockstep=True,
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
        if self.at_once and [peer for _, peer in down] == [CONTROLLER]:
            down = self._alternate(down)
        for datagram in self._carried(down, "down"):
            self.controller.receive(datagram, VEHICLE, self.now_us)
        up = self.controller.poll(self.now_us)
        for datagram in self._carried([(datagram, CONTROLLER) for datagram, _ in up], "up"):
            self.vehicle.receive(datagram, CONTROLLER, self.now_us)
        self.now_us += 10
        if not (down or up):
            self.now_us = min(self.vehicle.deadline_us(), self.controller.deadline_us())

    def _alternate(self, down: list[tuple[bytes, tuple]]) -> list[tuple[bytes, tuple]]:
        """Exchange some turns in machine code, up to what happens on the way; return what is then to be carried."""
        samples, answers = self.vehicle.begin_exchange(), self.controller.begin_exchange()
        odd = [at - count for at in (60, 80, 100, 120, 170) for count in self.counts.values() if at > count]
        turns = min([7, *(until - 1 for until in odd)])
        if samples is None or answers is None or turns < 1 or not answers.line.put(down[0][0]):
            return down
        _exchange(samples._replace(turns=min(samples.turns, turns)), answers)
        self.controller.end_exchange(answers, self.now_us)
        self.vehicle.end_exchange(samples, self.now_us)
        flown = samples.line.turns
        assert flown == answers.line.turns
        for turn in range(flown):
            for wire_, way in ((answers.line.taken, "down"), (answers.line.given, "up")):
                frame = answers.line.log[int(way == "up"), turn, : wire_.model.size].tobytes()
                self.said.append((frame, CONTROLLER))
                self.counts[way] += 1
        self.turns += flown
        return [(samples.line.answer, CONTROLLER)] if flown else down

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
def test_turns_leave_every_datagram_record_and_figure_as_they_are_step_by_step(law, watched):
    at_once, step_by_step = (Pair(law, watched=watched, at_once=turns) for turns in (True, False))
    assert at_once.vehicle.outcome is step_by_step.vehicle.outcome is VehicleOutcome.DONE
    assert at_once.rows == step_by_step.rows
    assert at_once.said == step_by_step.said
    assert at_once.figures == step_by_step.figures
    assert at_once.turns > (30 if watched else 180)
    assert step_by_step.turns == 0
