"""Whatever comes in: nothing is raised, no memory grows, and the next good command is obeyed.

A million datagrams in each run, always the same; hypothesis on top; a corpus of those that were, or could be, trouble.
"""

import gc
import json
import random
import struct
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as wire

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.mavlink.channel import Channel
from firmware_model.mavlink.frames import DAMAGE_REASONS, EncodedMessage, Frame, RejectReason, parse
from firmware_model.mavlink.messages import CONTROLLER, heartbeat_message, imu_message
from firmware_model.mavlink.peers import MAX_PEERS
from firmware_model.mavlink.signing import Signing
from firmware_model.session.vehicle_endpoint import VehicleEndpoint
from firmware_model.types import ImuSample
from gustproof.flight.endpoint.endpoint import ControllerEndpoint
from gustproof.law.form import load_law

KEY = bytes(range(32))
NOW = 1_700_000_000_000_000  # [us] Unix time at the start of the virtual clock
GROUND = (0, ("ground", 14550))
PEERS = [GROUND, *((0, ("peer", number)) for number in range(MAX_PEERS + 8))]
SETPOINTS = (wire.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET, wire.MAVLINK_MSG_ID_SET_ACTUATOR_CONTROL_TARGET)
FLOATS = [0.0, 1.0, -1.0, 6.0, 21196.0, 1e9, 3.4e38, -3.4e38, 1e-45, float("nan"), float("inf"), float("-inf")]
HOSTILE = [struct.pack("<f", value) for value in FLOATS] + [
    struct.pack("<I", value) for value in (1, 255, 65535, 2**31 - 1, 2**31, 2**32 - 1)
]
_GROWTH = 1_000  # blocks of memory that bounded tables and caches may still take after the first tenth


def place(message_id: int, name: str) -> tuple[int, int] | None:
    """Offset and size of a field on the wire, `None` if the message has no such field."""
    kind = wire.mavlink_map[message_id]
    at = 0
    for field, code, length in zip(kind.ordered_fieldnames, kind.native_format[1:], kind.array_lengths, strict=True):
        size = struct.calcsize(f"<{chr(code)}") * max(length, 1)
        if field == name:
            return at, size
        at += size
    return None


class Generator:
    """Datagrams from a seed: noise, damaged frames, and whole ones with hostile fields to those who read them."""

    def __init__(self, seed: int, numbers: list[int], fields: dict[str, list[bytes]], key: bytes | None = None) -> None:
        self.chance = random.Random(seed)
        self.read, self.known = numbers, sorted(wire.mavlink_map)
        self.sizes = {number: wire.mavlink_map[number].unpacker.size for number in self.known}
        self.fields = {
            number: [
                (at, at + size, [value[:size].ljust(size, b"\0") for value in values])
                for name, values in fields.items()
                for at, size in filter(None, [place(number, name)])
            ]
            for number in self.known
        }
        signings = [Signing(bytes(32), NOW), Signing(key, NOW) if key else None]
        for signing in filter(None, signings):
            signing.tick(0)
        self.senders = [Channel(1, CONTROLLER, signings[1])] * 3
        self.senders += [Channel(1, 1, signings[1]), Channel(255, 190, signings[1]), Channel(9, 9, signings[0])]
        self.senders += [Channel(9, 8)] if key else []

    def below(self, end: int) -> int:
        """Return a random number from 0; `Random.randrange` would take half of the time of these tests."""
        return int(self.chance.random() * end)

    def pick(self, items: Sequence[Any]) -> Any:
        return items[int(self.chance.random() * len(items))]

    def whole(self) -> bytes:
        """A frame that passes every check of its form."""
        number = self.pick(self.read if self.chance.random() < 0.85 else self.known)
        payload = bytearray(self.chance.randbytes(self.sizes[number]))
        words = (len(payload) + 3) // 4
        for _ in range(self.below(5)):
            word, at = self.pick(HOSTILE), 4 * self.below(words)
            payload[at : at + 4] = word[: len(payload) - at]
        for at, end, values in self.fields[number]:
            if self.chance.random() < 0.9:
                payload[at:end] = self.pick(values)
        return self.pick(self.senders).pack(EncodedMessage(number, bytes(payload)))

    def damaged(self) -> bytes:
        datagram = bytearray(self.whole())
        for _ in range(1 + self.below(3)):
            datagram[self.below(len(datagram))] ^= 1 << self.below(8)
        return bytes(datagram)

    def truncated(self) -> bytes:
        datagram = self.whole()
        return datagram[: self.below(len(datagram))]

    def noise(self) -> bytes:
        begin = self.pick((b"", b"\xfd", b"\xfe", b"\xfd\x09\x00", b"\xfd\xff\x01\x00"))
        return begin + self.chance.randbytes(self.below(300))

    def several(self) -> bytes:
        return self.whole() + self.pick((self.whole, self.truncated, self.noise))() + self.whole()

    def __iter__(self) -> Iterator[bytes]:
        kinds = [self.whole] * 8 + [self.damaged] * 4 + [self.truncated] * 3 + [self.noise] * 4 + [self.several]
        while True:
            yield self.pick(kinds)()


def vehicle(**options) -> VehicleEndpoint:
    """A vehicle of which `GROUND` is an expected peer."""
    scenario = replace(load_scenario("calm"), duration_s=1e4)
    return VehicleEndpoint(load_vehicle("paper"), scenario, 1, lambda _: None, expected=[GROUND], **options)


def to_vehicle(endpoint: VehicleEndpoint, seed: int, key: bytes | None = None) -> Generator:
    """A generator that knows what the vehicle reads: its messages, commands and parameters."""
    fields = {
        "target_system": [b"\0", b"\1", b"\1", b"\7"],
        "target_component": [b"\0", b"\1", b"\1", b"\xbf"],
        "command": [struct.pack("<H", number) for number in endpoint.services.commands],
        "param_id": [parameter.name.encode() for parameter in endpoint.parameters.table],
        "type_mask": [b"\0", b"\x07", b"\x80", b"\xff"],
    }
    return Generator(seed, [*endpoint.services.requests, *SETPOINTS], fields, key)


def feed(take: Callable[[bytes, int], None], datagrams: Iterator[bytes], count: int) -> int:
    """Give `count` datagrams to `take` with the time [us]; return how many blocks of memory stayed after a tenth."""
    settled = 0
    for number in range(count):
        if number == count // 10:
            gc.collect()
            settled = sys.getallocatedblocks()
        # Now and then everybody has been silent for so long that they are forgotten.
        take(next(datagrams), number * 4 + number // (count // 4) * 11_000_000)
    gc.collect()
    return sys.getallocatedblocks() - settled


class Ground:
    """A ground station that talks sense."""

    def __init__(self, endpoint: VehicleEndpoint, now_us: int, signing: Signing | None = None) -> None:
        self.endpoint, self.now_us, self.traffic = endpoint, now_us, Channel(255, 190, signing, 7)
        if signing is not None:
            signing.tick(now_us)

    def ask(self, message) -> list:
        self.endpoint.receive(self.traffic.pack(message), GROUND, self.now_us)
        return [
            frame.message()
            for datagram, peer in self.endpoint.poll(self.now_us)
            for frame in parse(datagram)
            if peer == GROUND
        ]

    def command(self, number: int, *parameters: float) -> int:
        numbers = (*parameters, *[0.0] * (7 - len(parameters)))
        answers = self.ask(wire.MAVLink_command_long_message(1, 1, number, 0, *numbers))
        (result,) = [answer.result for answer in answers if answer.get_type() == "COMMAND_ACK"]
        return result

    def is_obeyed(self) -> None:
        values = self.ask(wire.MAVLink_param_set_message(1, 1, b"COM_OF_LOSS_T", 2.5, 9))
        assert ("COM_OF_LOSS_T", 2.5) in [(m.param_id, m.param_value) for m in values if m.get_type() == "PARAM_VALUE"]
        assert self.command(wire.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, 21196.0) == wire.MAV_RESULT_ACCEPTED
        assert self.endpoint.autopilot.armed is False
        assert self.command(wire.MAV_CMD_DO_SET_MODE, 1.0, 7.0) == wire.MAV_RESULT_ACCEPTED
        assert self.command(wire.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == wire.MAV_RESULT_ACCEPTED
        assert self.endpoint.autopilot.armed is True


KINDS = {
    "standing": {"lockstep": False, "interactive": True},
    "scripted": {"lockstep": False},
    "lockstep": {"lockstep": True},
    "signed": {"lockstep": False, "interactive": True},
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_tenth_of_a_million_datagrams_leave_the_vehicle_as_good_as_before(kind):
    signed = kind == "signed"
    endpoint = vehicle(**KINDS[kind], signing=Signing(KEY, NOW) if signed else None)
    generator = to_vehicle(endpoint, 1 + [*KINDS].index(kind), KEY if signed else None)
    latest_us = 0

    def take(datagram: bytes, now_us: int) -> None:
        nonlocal latest_us
        latest_us = now_us
        endpoint.receive(datagram, generator.pick(PEERS), now_us)
        if now_us % 32 == 0:
            endpoint.poll(now_us)

    assert feed(take, iter(generator), 100_000) < _GROWTH
    causes = {*DAMAGE_REASONS, RejectReason.OTHER_TARGET, RejectReason.UNUSED_MESSAGE, RejectReason.TOO_MANY_PEERS}
    causes |= (
        {RejectReason.NOT_SIGNED, RejectReason.WRONG_SIGNATURE, RejectReason.REPLAYED}
        if signed
        else {RejectReason.NO_SETPOINT}
    )
    assert causes <= endpoint.counters.keys()
    assert len(endpoint.links) <= MAX_PEERS + 1
    Ground(endpoint, latest_us, Signing(KEY, NOW) if signed else None).is_obeyed()


def to_controller(seed: int) -> Generator:
    """A generator that knows what the controller reads."""
    fields = {
        "command": [struct.pack("<H", number) for number in (176, 400)],
        "param_id": [b"GP_TRQ_MAX_R", b"GP_TRQ_MAX_P", b"GP_TRQ_MAX_Y", b"IMU_INTEG_RATE", b"MPC_THR_HOVER"],
        "param_type": [b"\x06", b"\x09"],
        "custom_mode": [struct.pack("<I", number << 16) for number in (6, 7)],
        "result": [b"\0", b"\1"],
        "fields_updated": [b"\x3f\0"],
    }
    numbers = [wire.MAVLINK_MSG_ID_HEARTBEAT, wire.MAVLINK_MSG_ID_PARAM_VALUE, wire.MAVLINK_MSG_ID_COMMAND_ACK]
    return Generator(seed, [*numbers, wire.MAVLINK_MSG_ID_STATUSTEXT, wire.MAVLINK_MSG_ID_HIGHRES_IMU], fields)


class Autopilot:
    """A vehicle that talks sense to a controller until it answers samples."""

    def __init__(self, endpoint: ControllerEndpoint) -> None:
        self.endpoint, self.traffic = endpoint, Channel(1, 1)

    def is_obeyed(self, time_us: int, now_us: int) -> None:
        values = [(name, 10.0, 9) for name in (b"GP_TRQ_MAX_R", b"GP_TRQ_MAX_P", b"GP_TRQ_MAX_Y")]
        values.append((b"MPC_THR_HOVER", 0.5, 9))
        values.append((b"IMU_INTEG_RATE", struct.unpack("<f", struct.pack("<i", 250))[0], 6))
        beat = heartbeat_message(7 << 16, False, critical=False)
        sample = imu_message(ImuSample(time_us=time_us, gyro_B=(0.1, 0.0, 0.0), specific_force_B=(0.0, 0.0, -9.8)))
        for message in (beat, *(wire.MAVLink_param_value_message(*value, 4, 0) for value in values), sample):
            self.endpoint.receive(self.traffic.pack(message), GROUND, now_us)
        sent = [frame.message() for datagram, _ in self.endpoint.poll(now_us) for frame in parse(datagram)]
        assert time_us in [m.time_usec for m in sent if m.get_type() == "SET_ACTUATOR_CONTROL_TARGET"]


def test_a_tenth_of_a_million_datagrams_from_its_vehicle_break_no_controller():
    law, sessions = load_law("hinf-d1"), 0
    endpoint = ControllerEndpoint(law, GROUND)

    def take(datagram: bytes, now_us: int) -> None:
        nonlocal endpoint, sessions
        endpoint.receive(datagram, GROUND, now_us)
        if now_us % 32 == 0:
            endpoint.poll(now_us)
        if endpoint.finished:
            endpoint, sessions = ControllerEndpoint(law, GROUND), sessions + 1

    assert feed(take, iter(to_controller(6)), 100_000) < _GROWTH
    assert sessions > 10
    Autopilot(ControllerEndpoint(law, GROUND)).is_obeyed(0, 0)


def test_what_strangers_and_a_bad_line_say_leaves_the_controller_as_good_as_before():
    endpoint = ControllerEndpoint(load_law("hinf-d1"), GROUND)
    generator = to_controller(5)
    kinds = (generator.truncated, generator.noise)

    def datagrams() -> Iterator[bytes]:
        while True:
            yield generator.pick(kinds)()

    assert feed(lambda datagram, _: endpoint.receive(datagram, GROUND, 0), datagrams(), 50_000) < _GROWTH
    stranger = (0, ("stranger", 1))
    assert feed(lambda datagram, _: endpoint.receive(datagram, stranger, 0), iter(generator), 50_000) < _GROWTH
    assert not endpoint.finished
    Autopilot(endpoint).is_obeyed(0, 0)


@pytest.fixture(scope="module")
def listening() -> list[VehicleEndpoint | ControllerEndpoint]:
    controller = ControllerEndpoint(load_law("hinf-d1"), GROUND)
    vehicles = [
        vehicle(**options, signing=Signing(KEY, NOW) if kind == "signed" else None) for kind, options in KINDS.items()
    ]
    return [*vehicles, controller]


frames = st.builds(
    lambda number, payload, sequence: _frame(number, payload, sequence),
    st.sampled_from(sorted(wire.mavlink_map)),
    st.binary(max_size=255),
    st.integers(0, 255),
)


def _frame(number: int, payload: bytes, sequence: int) -> bytes:
    packer = wire.MAVLink(None, 1, 1)
    packer.seq = sequence
    return EncodedMessage(number, payload).pack(packer)


@given(st.lists(st.binary(max_size=300) | frames, max_size=5))
def test_any_bytes_and_any_payload_are_survived(listening, parts):
    for endpoint in listening:
        endpoint.receive(b"".join(parts), GROUND, 0)
        endpoint.poll(0)


@given(frames, st.binary(max_size=300))
def test_what_follows_a_frame_does_not_change_how_it_is_read(first, rest):
    (alone,) = parse(first)
    assert parse(first + rest)[0] == alone
    assert parse(first + rest)[1:] == parse(rest)


@given(frames)
def test_every_frame_that_is_read_becomes_a_message(datagram):
    (frame,) = parse(datagram)
    assert isinstance(frame, Frame)
    assert frame.message().get_msgId() == frame.message_id


CORPUS = json.loads((Path(__file__).parents[1] / "golden" / "datagrams.json").read_text())["datagrams"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("entry", CORPUS, ids=[entry["what"] for entry in CORPUS])
def test_datagrams_that_were_trouble_are_none(entry, kind):
    datagram = bytes.fromhex(entry["hex"])
    endpoint = vehicle(**KINDS[kind])
    ground = Ground(endpoint, 4_000)
    for _ in range(3):
        endpoint.receive(datagram, (0, ("peer", 1)), 0)
        endpoint.poll(0)
        endpoint.poll(2_000_000)
    ground.now_us = 2_000_000
    ground.is_obeyed()
    controller = ControllerEndpoint(load_law("hinf-d1"), GROUND)
    controller.receive(datagram, GROUND, 0)
    controller.poll(0)


@pytest.mark.parametrize("entry", CORPUS, ids=[entry["what"] for entry in CORPUS])
def test_datagrams_of_the_corpus_are_read_as_noted(entry):
    read = [
        item.value if isinstance(item, RejectReason) else item.message_id for item in parse(bytes.fromhex(entry["hex"]))
    ]
    assert read == entry["read"]
