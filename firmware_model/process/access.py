"""Access control of a process: the options --bind and --signing-key.

Loopback is trusted: any program on this machine may command. Any other address needs a key, unless the user gives
`none` in its place.
"""

from pathlib import Path

from firmware_model.errors import ConfigError
from firmware_model.mavlink.signing import Signing, read_key
from firmware_model.process import udp

LOOPBACK = "127.0.0.1"
"""Default address of a process."""
NO_KEY = Path("none")
"""In place of a key: commands of anyone are accepted."""


def make_signing(host: str, signing_key: Path | None = None, *, strict: bool = False) -> Signing | None:
    """Return the signing of messages, `None` without a key; `strict` rejects even an unsigned HEARTBEAT.

    `signing_key` is a file of 32 bytes or 64 hex digits, or `NO_KEY` unless there is a file of that name.

    Raises
    ------
    ConfigError
        If the key can't be used, or none is given and `host` is not loopback.
    """
    is_open = signing_key == NO_KEY and not NO_KEY.exists()
    if signing_key is not None and not is_open:
        key, start_us = read_key(signing_key), udp.unix_us()
        return Signing(key, start_us, frozenset()) if strict else Signing(key, start_us)
    if not (is_open or udp.is_loopback(host)):
        raise ConfigError(
            f"{host} is beyond this machine: give --signing-key FILE, or --signing-key none to obey anyone who commands"
        )
    return None
