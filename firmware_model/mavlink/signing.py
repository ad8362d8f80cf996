"""Message signing: accept commands only with a secret key, and reject replayed frames.

A frame carries 48 bits of SHA-256 over key and frame, and a time stamp that grows within each stream. A stream is a
sender's system, component and link id, whatever its address: a captured frame is rejected from every address.

A stamp more than a minute ahead of the receiver's own clock is refused, and no peer moves that clock. Otherwise one
sender with a clock in the future would lock out all others, whose first stamps would then be too old.

Limit: the receiver keeps no stamps between runs. Within a minute of the start, a frame captured in the previous run
can be replayed once. Keep eavesdroppers off the network.

References
----------
MAVLink, message signing: signature, time stamp handling, accepting unsigned packets.
"""

import os
import string
from hmac import compare_digest
from pathlib import Path

from pymavlink.dialects.v20 import all as wire

from firmware_model.errors import ConfigError
from firmware_model.mavlink.frames import Frame, RejectReason, signature

KEY_BYTES = 32
"""Length of a key."""
MAX_STREAMS = 256
"""Most streams at once; opening one requires the key."""
_EPOCH_US = 1_420_070_400_000_000  # 2015-01-01 in Unix time, the zero of time stamps
_UNIT_US = 10
_MINUTE = 60_000_000 // _UNIT_US  # largest age of a stream's first stamp, and largest lead of any
_MAX_STAMP = 2**48 - 1
_SIGNATURE, _STAMP = slice(-6, None), slice(-12, -6)
_LINK = -13
_UNSIGNED_MESSAGES = frozenset({wire.MAVLINK_MSG_ID_HEARTBEAT, wire.MAVLINK_MSG_ID_RADIO_STATUS})


class Signing:
    """A key with the newest time stamp of each stream; the caller owns the clock.

    `unix_us` is the Unix time [us] at which `now_us` is 0. Messages in `unsigned` are accepted without a signature:
    a telemetry radio has no key, and heartbeats are no secret.
    """

    def __init__(self, key: bytes, unix_us: int, unsigned: frozenset[int] = _UNSIGNED_MESSAGES) -> None:
        if len(key) != KEY_BYTES:
            raise ValueError(f"a signing key has {KEY_BYTES} bytes, not {len(key)}")
        self.key = key
        self._offset_us, self._unsigned = unix_us - _EPOCH_US, unsigned
        self._clock = self._stamp = 0
        self._streams: dict[tuple[int, int, int], int] = {}

    def tick(self, now_us: int) -> None:
        """Set the clock."""
        self._clock = (self._offset_us + now_us) // _UNIT_US
        self._stamp = max(self._stamp, self._clock)

    def next_stamp(self) -> int:
        """Return a new time stamp [10 us since 2015] for an outgoing frame, larger than the last one."""
        self._stamp = min(self._stamp + 1, _MAX_STAMP)
        return self._stamp

    def check(self, frame: Frame) -> RejectReason | None:
        """Return why a frame is rejected, `None` if it is accepted; record the stamp of a genuine frame."""
        if not frame.is_signed:
            return None if frame.message_id in self._unsigned else RejectReason.NOT_SIGNED
        raw = frame.raw
        stream = raw[_LINK], frame.system, frame.component
        stamp, last = int.from_bytes(raw[_STAMP], "little"), self._streams.get(stream)
        if last is not None and stamp <= last:
            return RejectReason.REPLAYED
        if not compare_digest(signature(self.key, raw[: _SIGNATURE.start]), raw[_SIGNATURE]):
            return RejectReason.WRONG_SIGNATURE
        if stamp > self._clock + _MINUTE:
            return RejectReason.AHEAD_OF_CLOCK
        if last is None and stamp + _MINUTE < self._clock:
            return RejectReason.OUT_OF_DATE
        # Recorded only after the signature check: a forged future stamp would lock the true sender out.
        if last is None and len(self._streams) >= MAX_STREAMS:
            return RejectReason.TOO_MANY_PEERS
        self._streams[stream] = stamp
        return None


def read_key(path: Path) -> bytes:
    """Return the key in a file: 32 bytes, or 64 hexadecimal digits. Only the file's owner may have read access.

    Raises
    ------
    ConfigError
        If the file cannot be read, is readable by others, or holds no key.
    """
    try:
        with path.open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            content = file.read(4096)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    if os.name == "posix" and mode & 0o077:
        raise ConfigError(f"{path}: others can read this key, its mode is {mode & 0o777:o}; run 'chmod 600' on it")
    if len(content) == KEY_BYTES:
        return content
    digits = content.strip()
    if len(digits) == 2 * KEY_BYTES and set(digits) <= set(string.hexdigits.encode()):
        return bytes.fromhex(digits.decode())
    raise ConfigError(f"{path}: a signing key is {KEY_BYTES} bytes, or {2 * KEY_BYTES} hexadecimal digits")
