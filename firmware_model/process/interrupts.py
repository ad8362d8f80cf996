"""Signals that end a process in order."""

import signal
from collections.abc import Callable


def call_on_interrupt(interrupt: Callable[[], None]) -> None:
    """Call `interrupt` on Ctrl-C, on SIGTERM, and on SIGHUP of a terminal that closes, unless nohup ignores that."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # not every system has all
        if number is not None and not (name == "SIGHUP" and signal.getsignal(number) is signal.SIG_IGN):
            signal.signal(number, lambda *_: interrupt())
