"""Datagrams and the clock in kernels: three functions of the C library, called without Python in between."""

import ctypes
from functools import cache
from typing import Any

from firmware_model.numerics.compiled import INLINED, kernel

# isort: split
import numpy as np
from numba.core import types
from numba.extending import overload
from numpy.typing import NDArray

ADDRESS_SIZE = 16
"""[bytes] of an IPv4 address with its port, a `sockaddr_in`."""
Bytes = NDArray[np.uint8]
_CLOCK_MONOTONIC = 1  # of Linux
_POINTER: Any = types.uintp
_SIZE: Any = types.intp
_INT: Any = types.int32


@cache
def _library() -> Any:
    library: Any = ctypes.CDLL(None)
    pointer, size, number = ctypes.c_void_p, ctypes.c_ssize_t, ctypes.c_int
    library.recvfrom.argtypes = number, pointer, size, number, pointer, pointer
    library.sendto.argtypes = number, pointer, size, number, pointer, number
    library.clock_gettime.argtypes = number, pointer
    library.recvfrom.restype = library.sendto.restype = size
    return library


def _recvfrom(socket: int, into: int, size: int, flags: int, address: int, length: int) -> int:
    return int(_library().recvfrom(socket, into, size, flags, address, length))


def _sendto(socket: int, content: int, size: int, flags: int, address: int, length: int) -> int:
    return int(_library().sendto(socket, content, size, flags, address, length))


def _clock_gettime(clock: int, time: int) -> int:
    return int(_library().clock_gettime(clock, time))


# In kernels the same functions, found by their names when the machine code is loaded.
_receive = types.ExternalFunction("recvfrom", _SIZE(_INT, _POINTER, _SIZE, _INT, _POINTER, _POINTER))
_send = types.ExternalFunction("sendto", _SIZE(_INT, _POINTER, _SIZE, _INT, _POINTER, _INT))
_tell_time = types.ExternalFunction("clock_gettime", _INT(_INT, _POINTER))
overload(_recvfrom, **INLINED)(lambda s, i, n, f, a, m: lambda s, i, n, f, a, m: _receive(s, i, n, f, a, m))
overload(_sendto, **INLINED)(lambda s, c, n, f, a, m: lambda s, c, n, f, a, m: _send(s, c, n, f, a, m))
overload(_clock_gettime, **INLINED)(lambda c, t: lambda c, t: _tell_time(c, t))


@kernel
def receive_datagram(socket: int, datagram: Bytes, sender: Bytes) -> int:
    """Wait for a datagram as long as the socket waits; return its size, or a negative number if none came.

    The address that it came from is written to `sender` (ADDRESS_SIZE + 4,), whose last four bytes hold its length.
    """
    sender[ADDRESS_SIZE] = ADDRESS_SIZE
    length = sender[ADDRESS_SIZE:].ctypes.data
    return _recvfrom(socket, datagram.ctypes.data, datagram.size, 0, sender.ctypes.data, length)


@kernel
def send_datagram(socket: int, datagram: Bytes, size: int, receiver: Bytes) -> None:
    """Send the first bytes of `datagram` to an address (ADDRESS_SIZE,); one that can't be sent now is lost."""
    _sendto(socket, datagram.ctypes.data, size, 0, receiver.ctypes.data, ADDRESS_SIZE)


@kernel
def read_clock(now: NDArray[np.int64]) -> int:
    """Return the time [us] of the clock of `time.monotonic`; `now` (2,) is work space."""
    _clock_gettime(_CLOCK_MONOTONIC, now.ctypes.data)
    return int(now[0] * 1_000_000 + now[1] // 1000)
