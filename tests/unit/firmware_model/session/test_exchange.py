"""Lockstep in machine code over real sockets: what it flies, what it leaves, and that no step by step differs."""

import math
import socket
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.modes import Mode
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.mavlink.channel import Channel
from firmware_model.mavlink.frames import parse
from firmware_model.mavlink.messages import CONTROLLER, command_message, parse_command, rate_template, torque_template
from firmware_model.mavlink.wire import make_line
from firmware_model.process import udp
from firmware_model.process.tlog import Tlog
from firmware_model.session.exchange import _read_setpoint, fly_samples, load_exchange, read_command
from firmware_model.session.vehicle_endpoint import VehicleEndpoint
from firmware_model.sim.inner_loop import RATES, SETPOINT_WIDTH, TORQUE
from firmware_model.sim.state import SimState
from firmware_model.sim.vehicle_loop import LoopArrays
from firmware_model.types import AttitudeTarget, Command, TorqueCommand

SAMPLE_US = 4000
HEARTBEAT = wire.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)


class Flight:
    """A vehicle in OFFBOARD that has flown sample 0 and waits for the answer to the next one; its controller."""

    def __init__(self, bound: socket.socket, client: socket.socket, *, rates: bool = False, delay: int = 0) -> None:
        self.bound, self.client, self.rates = bound, client, rates
        self.rows: list[bytes] = []
        scenario = replace(load_scenario("paper-turbulence"), duration_s=0.2, delay_samples=delay)
        self.endpoint = VehicleEndpoint(
            load_vehicle("paper"),
            scenario,
            1,
            lambda records: self.rows.extend(row.tobytes() for row in np.atleast_2d(records)),
            lockstep=True,
        )
        self.packer = wire.MAVLink(None, 1, CONTROLLER)
        self.peer = 0, client.getsockname()
        arm = wire.MAVLink_command_long_message(1, 1, wire.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1.0, *[0.0] * 6)
        mode = wire.MAVLink_command_long_message(1, 1, wire.MAV_CMD_DO_SET_MODE, 0, 1.0, 6.0, *[0.0] * 5)
        for message in (HEARTBEAT, self.command(0), arm, mode):
            self.say(self.pack(message))
        self.endpoint.poll(0)

    def command(self, sample: int) -> Any:
        torques = TorqueCommand(SAMPLE_US * sample, (0.125, -0.25, 0.0), None)
        rates = AttitudeTarget(SAMPLE_US * sample, None, (0.25, 0.0, -0.125), 0.5)
        return command_message(rates if self.rates else torques, 1)

    def pack(self, message: Any) -> bytes:
        datagram: bytes = message.pack(self.packer)
        self.packer.seq = (self.packer.seq + 1) & 255
        return datagram

    def say(self, datagram: bytes) -> None:
        self.endpoint.receive(datagram, self.peer, 0)
        for answer, (_, address) in self.endpoint.poll(0):
            self.bound.sendto(answer, address)

    def hear(self) -> list[bytes]:
        heard = []
        while True:
            try:
                heard.append(self.client.recv(70_000))
            except BlockingIOError:
                return heard


@pytest.fixture
def sockets() -> Iterator[tuple[socket.socket, socket.socket]]:
    with udp.bind(0) as bound, udp.bind(0) as client:
        yield bound, client


@pytest.mark.parametrize("rates", [False, True])
@pytest.mark.parametrize("delay", [0, 3])
def test_samples_that_come_on_the_socket_are_flown_as_step_by_step(sockets, rates, delay):
    flights = []
    for at_once in (True, False):
        flight = Flight(*sockets, rates=rates, delay=delay)
        flight.hear()
        said = [flight.pack(flight.command(sample)) for sample in range(1, 21)]
        if at_once:
            for datagram in said:
                flight.client.sendto(datagram, flight.bound.getsockname())
            line = flight.endpoint.exchange(flight.bound.fileno(), lambda: 7)
            assert line is not None
            assert (line.turns, line.left) == (20, None)
            assert flight.endpoint._now_us == flight.endpoint._commander.last_seen_us == 7
            assert line.address == flight.peer
        else:
            for datagram in said:
                flight.say(datagram)
        endpoint = flight.endpoint
        assert endpoint.flight.time_us == endpoint.loop.time_us == 21 * SAMPLE_US
        flights.append((flight.rows, flight.hear(), endpoint.links, endpoint.setpoint, endpoint.counters))
    assert flights[0] == flights[1]
    assert len(flights[0][0]) == 21
    assert len(flights[0][1]) == 20


def altered(at: int, flip: int) -> Callable[[Flight], bytes]:
    def alter(flight: Flight) -> bytes:
        datagram = bytearray(flight.pack(flight.command(3)))
        datagram[at] ^= flip
        return bytes(datagram)

    return alter


def other(time_us: int = 3 * SAMPLE_US, torque: tuple = (0.0, 0.0, 0.0), throttle: float | None = None) -> Any:
    return lambda flight: flight.pack(command_message(TorqueCommand(time_us, torque, throttle), 1))


def signed(flight: Flight) -> bytes:
    flight.packer.signing.secret_key, flight.packer.signing.sign_outgoing = bytes(32), True
    datagram = flight.pack(flight.command(3))
    flight.packer.signing.sign_outgoing = False
    return datagram


def skipped(flight: Flight) -> bytes:
    flight.packer.seq = (flight.packer.seq + 1) & 255
    return flight.pack(flight.command(3))


@pytest.mark.parametrize(
    "odd",
    [
        lambda flight: flight.pack(HEARTBEAT),
        lambda _: b"",
        lambda _: bytes(65_000),
        lambda flight: flight.pack(flight.command(3)) * 2,
        lambda flight: flight.pack(flight.command(3))[:-1],
        *(altered(at, 1 << at % 8) for at in (0, 1, 2, 4, 5, 7, 10, 18, 34, 49, 52, 53)),
        other(time_us=2 * SAMPLE_US),
        other(torque=(1.0625, 0.0, 0.0)),
        other(torque=(0.0, -1.0625, 0.0)),
        other(torque=(0.0, 0.0, math.nan)),
        other(throttle=0.5),
        signed,
        skipped,
        lambda flight: command_message(AttitudeTarget(3 * SAMPLE_US, None, (0.0, 0.0, 0.0), 0.5), 1).pack(
            flight.packer
        ),
    ],
)
def test_anything_else_is_left_as_it_came_and_means_what_it_always_did(sockets, odd):
    told = []
    for at_once in (True, False):
        flight = Flight(*sockets)
        flight.hear()
        usual = [flight.pack(flight.command(sample)) for sample in (1, 2)]
        strange = odd(flight)
        if at_once:
            for datagram in (*usual, strange):
                flight.client.sendto(datagram, flight.bound.getsockname())
            line = flight.endpoint.exchange(flight.bound.fileno(), lambda: 0)
            assert line is not None
            assert line.turns == 2
            assert line.left == (strange, flight.client.getsockname())
        else:
            for datagram in usual:
                flight.say(datagram)
        flight.say(strange)
        told.append((flight.rows, flight.hear(), flight.endpoint.links, flight.endpoint.counters))
    assert told[0] == told[1]


def test_a_call_ends_after_its_turns_and_reads_no_further(sockets):
    flight = Flight(*sockets)
    load_exchange(flight.endpoint.loop)
    for sample in (1, 2, 3):
        flight.client.sendto(flight.pack(flight.command(sample)), flight.bound.getsockname())
    begun = flight.endpoint.begin_exchange()
    assert begun is not None
    fly_samples(flight.bound.fileno(), begun._replace(turns=2))
    assert (begun.line.turns, begun.line.left) == (2, None)
    flight.endpoint.end_exchange(begun, 0)
    line = flight.endpoint.exchange(flight.bound.fileno(), lambda: 0)
    assert line is not None
    assert (line.turns, flight.endpoint.loop.sample) == (1, 4)


def test_a_record_has_the_mode_of_now_whatever_was_flown_before(sockets):
    flight = Flight(*sockets)
    flight.client.sendto(flight.pack(flight.command(1)), flight.bound.getsockname())
    begun = flight.endpoint.begin_exchange()
    assert begun is not None
    begun.loop.record[-1] = Mode.HOLD.value  # of the samples before OFFBOARD
    fly_samples(flight.bound.fileno(), begun)
    assert begun.records[0, -1] == Mode.OFFBOARD.value


def test_another_peer_is_heard_and_gets_no_sample(sockets):
    flight = Flight(*sockets)
    with udp.bind(0) as stranger:
        stranger.sendto(flight.pack(flight.command(1)), flight.bound.getsockname())
        line = flight.endpoint.exchange(flight.bound.fileno(), lambda: 0)
        assert line is not None
        assert line.turns == 0
        assert line.left is not None
        assert line.left[1] == stranger.getsockname()
        assert flight.endpoint.loop.sample == 1


def test_nothing_is_exchanged_while_anything_else_is_due_or_awaited(sockets):
    flight = Flight(*sockets)
    assert flight.endpoint.begin_exchange() is not None
    flight.endpoint.flight.pause(0, paused=True)
    assert flight.endpoint.begin_exchange() is None
    flight.endpoint.flight.pause(0, paused=False)
    flight.endpoint.receive(HEARTBEAT.pack(wire.MAVLink(None, 255, 190)), (0, ("127.0.0.1", 9)), 0)
    assert flight.endpoint.exchange(flight.bound.fileno(), lambda: 0) is None  # its streams are due
    flight.endpoint.poll(0)
    assert 0 < flight.endpoint.begin_exchange().turns <= 3  # up to the next of them
    flight = Flight(*sockets)
    flight.endpoint.loop.sample = 49
    assert flight.endpoint.begin_exchange() is None  # the last sample ends the flight


def test_the_log_has_each_frame_with_the_stamp_that_it_would_have_had(sockets, tmp_path):
    logs = []
    for at_once in (True, False):
        flight = Flight(*sockets)
        clock = flight.endpoint.flight
        path = tmp_path / f"{at_once}.tlog"
        with Tlog(
            path, flight.endpoint, lambda now_us, c=clock: 10**15 + c.clock_us(now_us), flight.endpoint.exchange
        ) as log:
            for sample in range(1, 5):
                datagram = flight.pack(flight.command(sample))
                if at_once and sample > 1:
                    flight.client.sendto(datagram, flight.bound.getsockname())
                else:
                    log.receive(datagram, flight.peer, 0)
                    log.poll(0)
            if at_once:
                assert log.exchange(flight.bound.fileno(), lambda: 0).turns == 3
                assert log.exchange(flight.bound.fileno(), lambda: 0).turns == 0
        content = path.read_bytes()
        logs.append(content)
    assert logs[0] == logs[1]


def one_loop() -> LoopArrays:
    nothing = np.zeros((1, 1))
    return LoopArrays(SimState(*[nothing] * 6, sample_us=4000), np.zeros((1, SETPOINT_WIDTH)), np.zeros(1), nothing)


def read_at_once(command: Command, *, time_us: int = 4000) -> Command | None:
    """Return what machine code makes of a command's datagram, while it waits for the answer to a sample."""
    torque = isinstance(command, TorqueCommand)
    template = (torque_template if torque else rate_template)(1)
    line, loop = make_line(template.buffer(), template.buffer(), ("127.0.0.1", 1)), one_loop()
    assert line.put(command_message(command, 1).pack(wire.MAVLink(None, 1, CONTROLLER)))
    kind = TORQUE if torque else RATES
    return read_command(loop, 0) if _read_setpoint(kind, line.taken, time_us, loop, 0) else None


def torques(*torque_B: float, throttle: float | None = None, time_us: int = 4000) -> TorqueCommand:
    return TorqueCommand(time_us=time_us, torque_B=torque_B, throttle=throttle)


def rates(*omega_B: float, thrust: float = 0.5, time_us: int = 4000) -> AttitudeTarget:
    return AttitudeTarget(time_us=time_us, q_NB=None, omega_B=omega_B, thrust=thrust)


@pytest.mark.parametrize(
    "command",
    [
        torques(0.25, -0.5, 0.0),
        torques(1.0, 1.0, 1.0),
        torques(-1.0, -1.0, -1.0),
        rates(0.5, -0.25, 2.0),
        rates(0.0, 0.0, 0.0, thrust=0.0),
        rates(-40.0, 40.0, 0.0, thrust=1.0),
    ],
)
def test_a_set_point_is_read_as_the_parser_reads_it(command):
    (frame,) = parse(Channel(1, CONTROLLER).pack(command_message(command, 1)))
    assert read_at_once(command) == parse_command(frame, 1) == command


@pytest.mark.parametrize(
    "command",
    [
        *(torques(*np.roll((value, 0.0, 0.0), axis).tolist()) for axis in range(3) for value in (1.0625, -1.0625)),
        *(torques(*np.roll((math.nan, 0.0, 0.0), axis).tolist()) for axis in range(3)),
        torques(0.0, 0.0, 0.0, throttle=0.5),
        torques(0.0, 0.0, 0.0, time_us=8000),
        torques(0.0, 0.0, 0.0, time_us=0),
        *(rates(*np.roll((math.nan, 0.0, 0.0), axis).tolist()) for axis in range(3)),
        rates(math.inf, 0.0, 0.0),
        rates(0.0, 0.0, 0.0, thrust=1.0625),
        rates(0.0, 0.0, 0.0, thrust=-0.0625),
        rates(0.0, 0.0, 0.0, thrust=math.nan),
        rates(0.0, 0.0, 0.0, time_us=8000),
        rates(0.0, 0.0, 0.0, time_us=0),
    ],
)
def test_a_set_point_with_anything_to_clip_or_refuse_is_left_to_the_parser(command):
    assert read_at_once(command) is None


def test_stamps_of_rates_wrap_after_49_days_as_those_on_the_wire():
    time_us = 2**32 * 1000 + 8000
    command = rates(0.0, 0.0, 0.0, time_us=8000)
    assert read_at_once(command, time_us=time_us) == command
