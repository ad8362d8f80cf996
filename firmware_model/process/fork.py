"""A child that is a copy of this process, so that it need not import what is imported here: half a second."""

import gc
import os
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

_STDERR = 2
_TASKS, _FILES, _NAME = Path("/proc/self/task"), Path("/proc/self/fd"), Path("/proc/self/comm")


def can_fork() -> bool:
    """Return whether a copy of this process would be whole: on Linux, where no other thread runs.

    A copy has this thread alone. What another one had locked would stay locked for ever.
    """
    try:
        return len(list(_TASKS.iterdir())) == 1
    except OSError:
        return False


def run_in_copy(name: str, main: Callable[[Sequence[str]], int], words: Sequence[str]) -> Callable[[], None]:
    """Return what a forked child calls in place of a program: it runs `main` on `words`, and ends with its status.

    It is for `preexec_fn` of `subprocess.Popen`, which has made streams and session by then. As a new Python does, the
    child begins without open files, without handlers of signals and without the current folder on its path. It is
    called `name`, of which the system keeps 15 letters.
    """

    def run() -> None:
        status = 1
        try:
            _begin_anew(name)
            status = main(words)
        except BaseException:  # as Python itself does it
            traceback.print_exc()
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        os._exit(status)  # nothing of the parent is tidied up here

    return run


def _begin_anew(name: str) -> None:
    for file in [int(entry.name) for entry in _FILES.iterdir()]:
        if file > _STDERR:
            with suppress(OSError):  # the list itself was one of them
                os.close(file)  # by the end of one of them the parent knows that the child runs
    gc.disable()  # what is there stays
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # by nohup
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
    sys.stdin, sys.stdout = open(0, closefd=False), open(1, "w", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", buffering=1, errors="backslashreplace", closefd=False)  # noqa: SIM115
    with suppress(FileNotFoundError):  # a folder that is gone holds no module
        here = ("", str(Path.cwd()))
        sys.path[:] = [entry for entry in sys.path if entry not in here]
    _NAME.write_text(name)
