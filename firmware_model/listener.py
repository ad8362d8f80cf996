"""One peer of the vehicle: what it is sent how often, and the sequence numbers of what it was sent."""

from pymavlink.dialects.v20 import all as wire

from firmware_model.frames import Frame, Message, Outgoing, Peer
from firmware_model.messages import AUTOPILOT, CONTROLLER

NEVER_US = 1 << 62
"""[us] a time that does not come."""

_IMU = wire.MAVLINK_MSG_ID_HIGHRES_IMU
_INTERVALS_US = {  # of a peer that has asked for nothing
    _IMU: 20_000,
    wire.MAVLINK_MSG_ID_ATTITUDE: 10_000,
    wire.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 20_000,
    wire.MAVLINK_MSG_ID_HIL_STATE_QUATERNION: 20_000,
    wire.MAVLINK_MSG_ID_ATTITUDE_TARGET: 100_000,
    wire.MAVLINK_MSG_ID_ACTUATOR_CONTROL_TARGET: 100_000,
}
_CONTROLLER_IMU_US = 4_000


class Listener:
    """A peer and its streams; `expected` ones are told of the vehicle unasked, and never forgotten."""

    def __init__(self, address: Peer, system: int, *, expected: bool) -> None:
        self.address, self.expected = address, expected
        self.heard_us: int | None = None
        self.next_us = NEVER_US
        self.controller = False
        self._packer = wire.MAVLink(None, system, AUTOPILOT)
        self._defaults_us: dict[int, int] = {}
        self._intervals_us: dict[int, int] = {}
        self._due_us: dict[int, int] = {}

    def pack(self, message: Message | Outgoing) -> bytes:
        """Return the message as a datagram to this peer, with the next of its sequence numbers."""
        datagram: bytes = message.pack(self._packer)
        self._packer.seq = (self._packer.seq + 1) % 256
        return datagram

    def identify(self, frame: Frame, *, lockstep: bool, clock_us: int) -> None:
        """Start the streams that a peer of this kind gets when it asks for nothing.

        A lockstep controller is sent each sample when it is due and nothing more, as every message costs it time.
        """
        controller = frame.component == CONTROLLER
        if self.heard_us is not None and (self.controller or not controller):
            return
        self.controller = controller
        if controller and lockstep:
            self._defaults_us = {_IMU: _INTERVALS_US[_IMU]}
        else:
            self._defaults_us = _INTERVALS_US | ({_IMU: _CONTROLLER_IMU_US} if controller else {})
        self._start(dict(self._defaults_us), clock_us)

    def set_interval(self, message_id: int, interval_us: int, clock_us: int) -> bool:
        """Set the time between two messages, 0 for the default, below 0 for never; False if it is not streamed."""
        if message_id not in _INTERVALS_US:
            return False
        intervals_us = {key: us for key, us in self._intervals_us.items() if key != message_id}
        if interval_us >= 0:
            default_us = self._defaults_us.get(message_id, _INTERVALS_US[message_id])
            intervals_us[message_id] = interval_us or default_us
        self._start(intervals_us, clock_us)
        return True

    def take_due(self, clock_us: int) -> list[int]:
        """Return the message ids that are due, and set when they are due again."""
        if clock_us < self.next_us:
            return []
        due = [message_id for message_id, due_us in self._due_us.items() if due_us <= clock_us]
        for message_id in due:
            interval_us = self._intervals_us[message_id]
            # What was missed is not made up for.
            again_us = self._due_us[message_id] + interval_us
            self._due_us[message_id] = again_us if again_us > clock_us else clock_us + interval_us
        self.next_us = min(self._due_us.values(), default=NEVER_US)
        return due

    def _start(self, intervals_us: dict[int, int], clock_us: int) -> None:
        self._intervals_us = intervals_us
        self._due_us = dict.fromkeys(intervals_us, clock_us)
        self.next_us = clock_us if intervals_us else NEVER_US
