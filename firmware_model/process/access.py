"""Who may reach a process and command it: the options --bind, --signing-key and --unsigned.

Loopback is trusted: who may open sockets on this machine may command. Beyond it a key is asked for, unless the user
says in so many words that anybody may.
"""

import argparse
from pathlib import Path

from firmware_model.errors import ConfigError
from firmware_model.mavlink.signing import Signing, read_key
from firmware_model.process import udp

LOOPBACK = "127.0.0.1"
"""Where a process is reached unless it is told otherwise."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add --signing-key and --unsigned, of which one at most is given."""
    either = parser.add_mutually_exclusive_group()
    either.add_argument(
        "--signing-key",
        type=Path,
        metavar="FILE",
        help="sign every message, and obey none without this key: 32 bytes or 64 hex digits, readable by you alone",
    )
    either.add_argument("--unsigned", action="store_true", help="obey anybody on the network, without a key")


def make_signing(options: argparse.Namespace, host: str, *, strict: bool = False) -> Signing | None:
    """Return what signs and checks messages, `None` for nothing; `strict` accepts not even a HEARTBEAT without a key.

    Raises
    ------
    ConfigError
        If the key can't be used, or none is given and `host` is not of this machine alone.
    """
    if options.signing_key is not None:
        key, start_us = read_key(options.signing_key), udp.unix_us()
        return Signing(key, start_us, frozenset()) if strict else Signing(key, start_us)
    if not (options.unsigned or udp.is_loopback(host)):
        raise ConfigError(f"{host} is beyond this machine: give --signing-key FILE, or --unsigned to obey anybody")
    return None
