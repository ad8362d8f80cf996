"""The status line: what comes and goes on each link, once a second, on the last line of a terminal."""

import shutil
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

PERIOD_S = 1.0
"""[s] from line to line."""


def line(links: Mapping[str, Mapping[str, Any]], width: int) -> str:
    """Return the links' figures in one line of at most `width` characters."""
    parts = (
        f"{peer} in {figures['in']} out {figures['out']} lost {figures['lost']} bad {figures['bad']} "
        f"rejected {sum(figures['rejected'].values())}"
        for peer, figures in links.items()
        if figures["in"]
    )
    return ("  |  ".join(parts) or "nobody is connected")[:width]


@contextmanager
def shown(links: Callable[[], Mapping[str, Mapping[str, Any]]]) -> Iterator[None]:
    """Show the line on standard error from a timer's signal, which costs the loop that flies nothing."""
    if not hasattr(signal, "setitimer"):  # not every system has it
        yield
        return

    def show(*_: object) -> None:
        width = shutil.get_terminal_size().columns - 1
        sys.stderr.write(f"\r{line(links(), width):<{width}}")
        sys.stderr.flush()

    signal.signal(signal.SIGALRM, show)
    signal.setitimer(signal.ITIMER_REAL, PERIOD_S, PERIOD_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        sys.stderr.write("\n")
