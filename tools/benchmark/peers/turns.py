"""Common part of the peers' programs: fly on request, and answer the speed."""

import json
import os
import sys
import time
from collections.abc import Callable

CORES = len(os.sched_getaffinity(0))
"""Number of cores that this process may use."""


def serve(fly: Callable[[], float]) -> None:
    """Fly once at the start and once for each input line, and answer the simulated seconds per second.

    `fly` returns the simulated seconds. The first answer means that everything is loaded and compiled.
    """
    _answer(fly)
    for _ in sys.stdin:
        _answer(fly)


def _answer(fly: Callable[[], float]) -> None:
    begun = time.perf_counter()
    simulated_s = fly()
    print(json.dumps({"rate": simulated_s / (time.perf_counter() - begun)}), flush=True)
