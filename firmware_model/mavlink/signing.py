"""Message signing: who may command, proved by a secret key; old frames are refused.

A frame carries 48 bits of SHA-256 over key and frame, and a time stamp that grows within each stream. A stream is a
sender's system, component and link id, wherever its datagrams come from: a frame that was overheard is refused from
every address. The receiver keeps no stamps between two runs, so within a minute of the start an overheard frame of the
run before can be played to it once; whoever can overhear must be kept off the network.

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
"""Streams known at once; only who holds the key can open one."""
_EPOCH_US = 1_420_070_400_000_000  # 2015-01-01 in Unix time: time stamps count from there
_UNIT_US = 10
_MINUTE = 60_000_000 // _UNIT_US  # how far behind the first stamp of a stream may be
_MAX_STAMP = 2**48 - 1
_SIGNATURE, _STAMP = slice(-6, None), slice(-12, -6)
_LINK = -13
_UNSIGNED_MESSAGES = frozenset({wire.MAVLINK_MSG_ID_HEARTBEAT, wire.MAVLINK_MSG_ID_RADIO_STATUS})


class Signing:
    """A key with the time stamps that were used with it; the caller owns the clock.

    `unix_us` is the Unix time [us] at which `now_us` is 0. Without a signature the messages `unsigned` are accepted:
    a telemetry radio has no key, and who is there may be told to all.
    """

    def __init__(self, key: bytes, unix_us: int, unsigned: frozenset[int] = _UNSIGNED_MESSAGES) -> None:
        if len(key) != KEY_BYTES:
            raise ValueError(f"a signing key has {KEY_BYTES} bytes, not {len(key)}")
        self.key = key
        self._offset_us, self._unsigned = unix_us - _EPOCH_US, unsigned
        self._stamp = 0
        self._streams: dict[tuple[int, int, int], int] = {}

    def tick(self, now_us: int) -> None:
        """Take the time."""
        self._stamp = max(self._stamp, (self._offset_us + now_us) // _UNIT_US)

    def next_stamp(self) -> int:
        """Return a new time stamp [10 us since 2015] for a frame of ours, each larger than the last."""
        self._stamp = min(self._stamp + 1, _MAX_STAMP)
        return self._stamp

    def refusal(self, frame: Frame) -> RejectReason | None:
        """Return why a frame is not to be obeyed, `None` if it is; notes the stamp of one that is genuine."""
        if not frame.signed:
            return None if frame.message_id in self._unsigned else RejectReason.NOT_SIGNED
        raw = frame.raw
        stream = raw[_LINK], frame.system, frame.component
        stamp, last = int.from_bytes(raw[_STAMP], "little"), self._streams.get(stream)
        if last is None and stamp + _MINUTE < self._stamp:
            return RejectReason.OUT_OF_DATE
        if last is not None and stamp <= last:
            return RejectReason.REPLAYED
        if not compare_digest(signature(self.key, raw[: _SIGNATURE.start]), raw[_SIGNATURE]):
            return RejectReason.WRONG_SIGNATURE
        # Only now, or a forged stamp from the future would shut the true sender out.
        if last is None and len(self._streams) >= MAX_STREAMS:
            return RejectReason.TOO_MANY_PEERS
        self._streams[stream] = stamp
        self._stamp = max(self._stamp, stamp)
        return None


def read_key(path: Path) -> bytes:
    """Return the key in a file that nobody but its owner can read: 32 bytes, or 64 hexadecimal digits.

    Raises
    ------
    ConfigError
        If the file can't be read, others can read it, or it holds no key.
    """
    try:
        with path.open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            content = file.read(4096)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    if os.name == "posix" and mode & 0o077:
        raise ConfigError(f"{path}: others can read this key, its mode is {mode & 0o777:o}: 'chmod 600' it")
    if len(content) == KEY_BYTES:
        return content
    digits = content.strip()
    if len(digits) == 2 * KEY_BYTES and set(digits) <= set(string.hexdigits.encode()):
        return bytes.fromhex(digits.decode())
    raise ConfigError(f"{path}: a signing key is {KEY_BYTES} bytes, or {2 * KEY_BYTES} hexadecimal digits")
