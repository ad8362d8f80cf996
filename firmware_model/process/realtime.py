"""What a process that flies asks of the interpreter and of the system: not to be interrupted."""

import gc
import os

_PRIORITY = 10  # of 1..99; what the system's own threads need is at 50 and above


def freeze_gc(*, off: bool) -> None:
    """Keep the garbage collector from what is there already; `off`: from all that comes, too.

    A flight leaves no cycles, and the collector's visits cost a sixth of it.
    """
    gc.collect()
    gc.freeze()
    if off:
        gc.disable()


def request_fifo_scheduling() -> bool:
    """Have the system run this thread before all usual ones (SCHED_FIFO), if it may; return whether it does.

    Threads and processes that it starts from here on are usual ones again.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(_PRIORITY))
    except (AttributeError, OSError):  # not every system has it, and few allow it to everybody
        return False
    return True
