"""Sessions with the real PX4 and ArduPilot, recorded once and flown again without them.

A transcript holds what the autopilot sent, exchange by exchange. Our world and client meet these bytes again, and must
send what they sent then, to the bit. With GUSTPROOF_PX4 or GUSTPROOF_ARDUPILOT, a build, a new session is recorded,
flown again, and left in the test's folder. What changes our side of the talk needs that file in `transcripts`.

Those without a number are of PX4 of March 2026 and of ArduCopter 4.6.3.
"""

import hashlib
import json
import lzma
import os
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from firmware_model.config.scenario import Scenario, load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.external import ardupilot_process
from firmware_model.external.__main__ import _exchanger, make_external
from firmware_model.external.client import ExternalClient
from firmware_model.external.flight import ExternalFlight
from firmware_model.external.interface import ExternalOptions
from firmware_model.external.px4_process import Px4
from firmware_model.external.readings import Readings
from firmware_model.external.world import World
from firmware_model.mavlink.frames import Address
from firmware_model.process import udp

HERE = Path(__file__).parent
STAND_INS = {"px4": HERE / "px4_build", "ardupilot": HERE}
BUILDS = {"px4": os.environ.get("GUSTPROOF_PX4", ""), "ardupilot": os.environ.get("GUSTPROOF_ARDUPILOT", "")}
SCRIPT = """
description = "a short gust"
duration_s = 0.5
control_rate_hz = {rate}
physics_rate_hz = {physics}
translation = "held"

[[wind]]
kind = "dryden"
wind_speed_20ft_mps = 10.0
"""
PEER: Address = (0, ("127.0.0.1", 1))


def short_gust(autopilot: str, folder: Path) -> Scenario:
    rate, physics = (250, 1000) if autopilot == "px4" else (400, 1200)
    path = folder / "short.toml"
    path.write_text(SCRIPT.format(rate=rate, physics=physics))
    return load_scenario(str(path))


def options(autopilot: str, build: str | Path, folder: Path) -> ExternalOptions:
    files = {"folder": folder / "run", "scenario": "short.toml", "vehicle": "paper", "journal": folder / "flight"}
    return ExternalOptions(autopilot=autopilot, build=Path(build), params=Path("tuned"), **files)


class Session:
    """What the autopilot sent by exchange and turn, and digests of what it was sent."""

    def __init__(self) -> None:
        self.exchanges: list[list[str]] = [[]]
        self.answered: list[bool] = []
        self.mavlink: defaultdict[str, list[str]] = defaultdict(list)
        self.sensors, self.commands = hashlib.sha256(), hashlib.sha256()
        self.turn = 0

    def digests(self) -> list[str]:
        return [self.sensors.hexdigest(), self.commands.hexdigest()]


class Link:
    """The client's end of the MAVLink link: counts turns, digests what it sends, hands on what it gets."""

    def __init__(self, client: ExternalClient, session: Session) -> None:
        self._client, self._session = client, session

    def receive(self, datagram: bytes, address: Address, now_us: int) -> None:
        frames = [frame for frame in split(datagram) if int.from_bytes(frame[7:10], "little") in self._client._handlers]
        if frames:
            self._session.mavlink[str(self._session.turn)].append(b"".join(frames).hex())
            self._client.receive(b"".join(frames), address, now_us)

    def poll(self, now_us: int) -> list[tuple[bytes, Address]]:
        self._session.turn += 1
        sent = self._client.poll(now_us)
        for datagram, _ in sent:
            self._session.commands.update(datagram)
        return sent


def split(datagram: bytes) -> list[bytes]:
    """Return the MAVLink 2 frames of a datagram; the streams that nobody reads are left out of transcripts."""
    frames = []
    while len(datagram) > 12:
        size = datagram[1] + (25 if datagram[2] & 1 else 12)
        frames.append(datagram[:size])
        datagram = datagram[size:]
    return frames


class Tape:
    """An external autopilot's link to the simulator as its parts: bytes to it, bytes from it."""

    def __init__(self, external: Any) -> None:
        self.external = external
        if isinstance(external, Px4):
            self._writer, self._reader, self._names = external._link, external._link, ("pack", "feed")
        else:
            self._writer, self._reader, self._names = ardupilot_process, external._reader, ("encode_answer", "read")
        self.encode, self.decode = getattr(self._writer, self._names[0]), getattr(self._reader, self._names[1])

    def divert(self, patch: pytest.MonkeyPatch, encode: Callable[..., Any], decode: Callable[..., Any]) -> None:
        patch.setattr(self._writer, self._names[0], encode)
        patch.setattr(self._reader, self._names[1], decode)


class Taped:
    """A real autopilot whose link to the simulator is taped."""

    def __init__(self, tape: Tape, session: Session, patch: pytest.MonkeyPatch) -> None:
        self._tape, self._session = tape, session
        tape.divert(patch, self._encode, self._decode)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._tape.external, name)

    def _encode(self, readings: Readings) -> bytes:
        sent: bytes = self._tape.encode(readings)
        self._session.sensors.update(sent)
        return sent

    def _decode(self, received: bytes) -> Any:
        self._session.exchanges[-1].append(received.hex())
        return self._tape.decode(received)

    def receive(self) -> tuple[float, ...] | None:
        self._session.exchanges.append([])
        rotors: tuple[float, ...] | None = self._tape.external.receive()
        self._session.answered.append(rotors is not None)
        return rotors


class Replayed:
    """An autopilot that is a transcript."""

    def __init__(self, tape: Tape, session: Session, told: dict[str, Any]) -> None:
        self._tape, self._session = tape, session
        self._exchanges, self._answered = iter(told["exchanges"]), iter(told["answered"])
        tape.external.instance = told["instance"]

    def __getattr__(self, name: str) -> Any:
        return getattr(self._tape.external, name)

    def start(self, client_port: int) -> None:
        self._decode()

    def send(self, readings: Readings) -> None:
        self._session.sensors.update(self._tape.encode(readings))

    def receive(self) -> tuple[float, ...] | None:
        frames = self._decode()
        if not next(self._answered):
            return None
        external = self._tape.external
        rotors: tuple[float, ...] = (
            external._link.answer.controls[:4] if isinstance(external, Px4) else frames[-1].rotors
        )
        return rotors

    def _decode(self) -> list[Any]:
        return [self._tape.decode(bytes.fromhex(chunk)) for chunk in next(self._exchanges)]


def fly(
    external: Any, client: ExternalClient, scenario: Scenario, exchange: Callable[[int, bool], None], port: int
) -> None:
    vehicle = load_vehicle("paper")
    flight = ExternalFlight(
        external, client, World(vehicle, scenario, 1, lambda _: None), vehicle, scenario, exchange=exchange
    )
    external.start(port)
    client.meet(external.system, external.client_port)
    flight.prepare()
    flight.fly()


def replay(told: dict[str, Any], folder: Path) -> tuple[ExternalClient, list[str]]:
    """Fly against a transcript; return the client, and the digests of what was sent."""
    scenario, session = short_gust(told["autopilot"], folder), Session()
    external = make_external(
        options(told["autopilot"], STAND_INS[told["autopilot"]], folder), scenario, load_vehicle("paper")
    )
    client = external.make_client()
    link = Link(client, session)

    def exchange(now_us: int, waits: bool) -> None:
        for datagram in told["mavlink"].get(str(session.turn), ()):
            client.receive(bytes.fromhex(datagram), PEER, now_us)
        link.poll(now_us)

    fly(Replayed(Tape(external), session, told), client, scenario, exchange, 0)
    return client, session.digests()


def record(autopilot: str, folder: Path, patch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Fly the real autopilot, and return its transcript."""
    scenario, session = short_gust(autopilot, folder), Session()
    external = make_external(options(autopilot, BUILDS[autopilot], folder), scenario, load_vehicle("paper"))
    client = external.make_client()
    with udp.bind(0) as bound:
        exchange = _exchanger(Link(client, session), bound, external.arrival_s, client)
        try:
            fly(Taped(Tape(external), session, patch), client, scenario, exchange, bound.getsockname()[1])
        finally:
            external.close()
    return {
        "autopilot": autopilot,
        "version": client.version,
        "instance": external.system - 1,
        "texts": list(client.texts),
        "digests": session.digests(),
        "answered": session.answered,
        "exchanges": session.exchanges,
        "mavlink": session.mavlink,
    }


def load(path: Path) -> dict[str, Any]:
    told: dict[str, Any] = json.loads(lzma.decompress(path.read_bytes()))
    return told


@pytest.mark.parametrize("name", ["px4-1.15", "px4", "ardupilot-4.5", "ardupilot", "ardupilot-4.8"])
def test_session_is_flown_again_to_the_bit(name: str, tmp_path: Path) -> None:
    told = load(HERE / "transcripts" / f"{name}.json.xz")
    assert told["version"].startswith(name.partition("-")[2])
    client, digests = replay(told, tmp_path)
    assert digests == told["digests"]
    assert (client.version, list(client.texts)) == (told["version"], told["texts"])
    assert client.reader.finished
    assert client.reader.describe_faults() == ""
    assert client.reader.unknown == []
    assert client.is_armed


@pytest.mark.parametrize("autopilot", [pytest.param(name, marks=pytest.mark.skipif(
    not build, reason=f"GUSTPROOF_{name.upper()} names no build")) for name, build in BUILDS.items()])  # fmt: skip
def test_real_session_is_flown_again_to_the_bit(
    autopilot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        told = record(autopilot, tmp_path, patch)
    path = tmp_path / f"{autopilot}.json.xz"
    path.write_bytes(lzma.compress(json.dumps(told).encode(), preset=9))
    assert replay(load(path), tmp_path)[1] == told["digests"]
