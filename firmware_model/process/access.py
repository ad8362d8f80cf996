"""Access control of a process: the options --bind, --signing-key and --unsigned.

Loopback is trusted: any program on this machine may command. Any other address needs a key, unless the user gives
--unsigned.
"""

import argparse
from pathlib import Path

from firmware_model.errors import ConfigError
from firmware_model.mavlink.signing import Signing, read_key
from firmware_model.process import udp

LOOPBACK = "127.0.0.1"
"""Default address of a process."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add --signing-key and --unsigned, which exclude each other."""
    either = parser.add_mutually_exclusive_group()
    either.add_argument(
        "--signing-key",
        type=Path,
        metavar="FILE",
        help="sign every message and reject those without this key: 32 bytes or 64 hex digits, readable by you alone",
    )
    either.add_argument(
        "--unsigned", action="store_true", help="accept commands from anyone on the network, without a key"
    )


def make_signing(options: argparse.Namespace, host: str, *, strict: bool = False) -> Signing | None:
    """Return the signing of messages, `None` without a key; `strict` rejects even an unsigned HEARTBEAT.

    Raises
    ------
    ConfigError
        If the key can't be used, or there is none and `host` is not loopback.
    """
    if options.signing_key is not None:
        key, start_us = read_key(options.signing_key), udp.unix_us()
        return Signing(key, start_us, frozenset()) if strict else Signing(key, start_us)
    if not (options.unsigned or udp.is_loopback(host)):
        raise ConfigError(
            f"{host} is beyond this machine: give --signing-key FILE, or --unsigned to accept commands from anyone"
        )
    return None
