from pathlib import Path

import pytest

from firmware_model.__main__ import main
from firmware_model.errors import ConfigError
from firmware_model.mavlink.channel import Channel
from firmware_model.mavlink.frames import RejectReason, parse
from firmware_model.process import access
from gustproof.flight.endpoint.__main__ import main as controller


@pytest.fixture
def key(tmp_path) -> Path:
    path = tmp_path / "key"
    path.write_bytes(bytes(range(32)))
    path.chmod(0o600)
    return path


def test_loopback_needs_no_key():
    assert access.make_signing("127.0.0.1") is None


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.5"])
def test_beyond_loopback_needs_a_key_or_a_word(host, key, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match="beyond this machine: give --signing-key FILE, or --signing-key none"):
        access.make_signing(host)
    assert access.make_signing(host, access.NO_KEY) is None
    assert access.make_signing(host, key) is not None


def test_strict_one_obeys_no_unsigned_heartbeat(key):
    from pymavlink.dialects.v20 import all as wire

    (beat,) = parse(Channel(1, 1).pack(wire.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)))
    signings = [access.make_signing("127.0.0.1", key, strict=strict) for strict in (False, True)]
    assert [signing.check(beat) for signing in signings if signing] == [None, RejectReason.NOT_SIGNED]


@pytest.mark.parametrize(
    "command",
    [lambda: main(["--bind", "0.0.0.0"]), lambda: controller(["--law", "hinf-d1", "--connect", "192.0.2.1:9"])],
)
def test_command_says_so_in_one_line_with_status_2(command, capsys):
    assert command() == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_key_in_a_file_named_none_is_a_key(key, monkeypatch):
    monkeypatch.chdir(key.parent)
    key.rename("none")
    assert access.make_signing("0.0.0.0", access.NO_KEY) is not None
