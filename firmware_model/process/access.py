"""Access control of a process: the options --bind, --signing-key and --unsigned.

Loopback is trusted: any program on this machine may command. Any other address needs a key, unless the user gives
--unsigned.
"""

from pathlib import Path

from firmware_model.errors import ConfigError
from firmware_model.mavlink.signing import Signing, read_key
from firmware_model.process import udp

LOOPBACK = "127.0.0.1"
"""Default address of a process."""


def make_signing(
    host: str, signing_key: Path | None = None, *, unsigned: bool = False, strict: bool = False
) -> Signing | None:
    """Return the signing of messages, `None` without a key; `strict` rejects even an unsigned HEARTBEAT.

    `signing_key` is a file of 32 bytes or 64 hex digits.

    Raises
    ------
    ConfigError
        If the key can't be used, or is given with `unsigned`, or there is neither and `host` is not loopback.
    """
    if signing_key is not None:
        if unsigned:
            raise ConfigError("--signing-key and --unsigned exclude each other")
        key, start_us = read_key(signing_key), udp.unix_us()
        return Signing(key, start_us, frozenset()) if strict else Signing(key, start_us)
    if not (unsigned or udp.is_loopback(host)):
        raise ConfigError(
            f"{host} is beyond this machine: give --signing-key FILE, or --unsigned to accept commands from anyone"
        )
    return None
