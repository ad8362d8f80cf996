"""What the programs of all peers share: they fly when they are asked to, and tell how fast that was."""

import json
import os
import sys
import time
from collections.abc import Callable

CORES = len(os.sched_getaffinity(0))
"""How many cores there are to be used."""


def serve(fly: Callable[[], float]) -> None:
    """Fly once to make ready, and once more for each line that comes, and answer the simulated seconds per second.

    `fly` returns how many seconds it has simulated. The first answer tells that all is loaded and compiled.
    """
    _answer(fly)
    for _ in sys.stdin:
        _answer(fly)


def _answer(fly: Callable[[], float]) -> None:
    begun = time.perf_counter()
    simulated_s = fly()
    print(json.dumps({"rate": simulated_s / (time.perf_counter() - begun)}), flush=True)
