"""Terminal output: a status line with the traffic of each link, once a second, and a summary at the end."""

import shutil
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

PERIOD_S = 1.0
"""[s] from line to line."""


def format_line(links: Mapping[str, Mapping[str, Any]], width: int) -> str:
    """Return the counters of all links in one line of at most `width` characters."""
    parts = (f"{peer} {_format_traffic(stats)}" for peer, stats in links.items() if stats["in"])
    return ("  |  ".join(parts) or "no peer is connected")[:width]


def format_summary(facts: Mapping[str, Any]) -> str:
    """Return the summary of a vehicle's run as lines of text, without peers that never sent."""
    samples = f"{facts['samples']} samples" if facts["of"] is None else f"{facts['samples']} of {facts['of']} samples"
    outcome = (facts["outcome"] or "broken off").replace("_", " ")
    rows = {}
    if (pace := facts["pace"]) and facts["samples"]:
        rows["deadlines"] = _format_pace(pace)
    if facts["slipped_s"]:
        rows["slipped"] = f"{facts['slipped_s']:.3f} s of wall time"
    if facts["counters"]:
        rows["counted"] = _format_counts(facts["counters"])
    rows |= {peer: _format_traffic(stats) for peer, stats in facts["links"].items() if stats["in"]}
    rows |= {f"link {way}": _format_counts(counts) or "no faults" for way, counts in facts["link_faults"].items()}
    headline = f"{outcome}: {samples} in {facts['wall_s']:.1f} s, speed {facts['realtime_factor']:.2f}x real time"
    return "\n".join((headline, *(f"  {name:<18} {text}" for name, text in rows.items())))


@contextmanager
def show_status_line(links: Callable[[], Mapping[str, Mapping[str, Any]]]) -> Iterator[None]:
    """Print the status line on standard error from a timer signal, at no cost to the flight loop."""
    if not hasattr(signal, "setitimer"):  # not every system has it
        yield
        return

    def show(*_: object) -> None:
        width = shutil.get_terminal_size().columns - 1
        sys.stderr.write(f"\r{format_line(links(), width):<{width}}")
        sys.stderr.flush()

    signal.signal(signal.SIGALRM, show)
    signal.setitimer(signal.ITIMER_REAL, PERIOD_S, PERIOD_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        sys.stderr.write("\n")


def _format_traffic(stats: Mapping[str, Any]) -> str:
    return (
        f"in {stats['in']} out {stats['out']} lost {stats['lost']} bad {stats['bad']} "
        f"rejected {sum(stats['rejected'].values())}"
    )


def _format_pace(pace: Mapping[str, Any]) -> str:
    return (
        f"{pace['missed']} missed; late by {pace['late_p50_us']} us (median), {pace['late_p99_us']} us (99 %), "
        f"{pace['late_worst_us']} us (worst), {'with' if pace['fifo'] else 'without'} FIFO scheduling"
    )


def _format_counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in counts.items())
