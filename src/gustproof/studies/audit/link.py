"""MAVLink over UDP to an autopilot that the audit has started."""

import contextlib
import socket
from typing import Any

from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.wire import LARGEST_DATAGRAM

_TIMEOUT_S = 0.2


class AutopilotLink:
    """A free port of the loopback interface, to which an autopilot speaks first."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(_TIMEOUT_S)
        self._mav: Any = wire.MAVLink(None, 255, 190)
        self._address: Any = None

    @property
    def port(self) -> int:
        """UDP port."""
        return int(self._socket.getsockname()[1])

    def send(self, *messages: Any) -> None:
        """Send messages in one datagram, if the autopilot has spoken."""
        if self._address is not None:
            self._socket.sendto(b"".join(message.pack(self._mav) for message in messages), self._address)

    def listen(self) -> list[Any]:
        """Return the messages of the next datagram; none if it does not come or is damaged."""
        with contextlib.suppress(TimeoutError, wire.MAVError):
            datagram, self._address = self._socket.recvfrom(LARGEST_DATAGRAM)
            return self._mav.parse_buffer(datagram) or []
        return []

    def close(self) -> None:
        """Free the port."""
        self._socket.close()
