"""How a process notices that whoever started it is gone."""

import os
import sys
from collections.abc import Callable
from threading import Thread

EXIT_ON_STDIN_EOF = "end in order when standard input does: whoever started this is gone"
"""What the option says that asks for it."""


def exit_on_stdin_eof(interrupt: Callable[[], None]) -> None:
    """Call `interrupt` when standard input ends: its other end is held by the starter, and not even a kill keeps it."""

    def wait() -> None:
        while os.read(sys.stdin.fileno(), 4096):
            pass
        interrupt()

    Thread(target=wait, daemon=True).start()
