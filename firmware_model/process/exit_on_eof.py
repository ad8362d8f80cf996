"""End of a process when its parent is gone."""

import os
import sys
from collections.abc import Callable
from threading import Thread


def exit_on_stdin_eof(interrupt: Callable[[], None]) -> None:
    """Call `interrupt` when standard input ends.

    Its other end belongs to the parent process, and even a kill closes it.
    """

    def wait() -> None:
        while os.read(sys.stdin.fileno(), 4096):
            pass
        interrupt()

    Thread(target=wait, daemon=True).start()
