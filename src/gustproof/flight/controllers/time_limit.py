"""Limit of the wall time that a user's Python may take in this process."""

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_LOOKS = 5  # within the limit


class TimeLimitExceeded(BaseException):
    """The limit is over; no `Exception`, so that a user's `except Exception` lets it pass."""


@contextmanager
def time_limit(limit_s: float, count: Callable[[], int] = lambda: 0) -> Iterator[None]:
    """Raise `TimeLimitExceeded` in the block once `count` has not changed for `limit_s` [s], or a fifth more.

    The alarm of the process (`setitimer`) does it, between two instructions of Python in the main thread. So it
    interrupts no single call into C, and in another thread nothing is limited. An alarm that was set before is set
    again.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    seen, since_s = count(), time.monotonic()

    def look(*_: object) -> None:
        nonlocal seen, since_s
        now, now_s = count(), time.monotonic()
        if now != seen:
            seen, since_s = now, now_s
        elif now_s >= since_s + limit_s:
            raise TimeLimitExceeded

    began_s, look_s = since_s, limit_s / _LOOKS
    handler = signal.signal(signal.SIGALRM, look)
    left_s, again_s = signal.setitimer(signal.ITIMER_REAL, look_s, look_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, signal.SIG_DFL if handler is None else handler)
        if left_s > 0.0:
            signal.setitimer(signal.ITIMER_REAL, max(left_s - (time.monotonic() - began_s), 1e-3), again_s)
