"""Process of an external autopilot: started in a folder of its own, and ended with all that it started."""

import contextlib
import ctypes
import os
import re
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

_SET_PARENT_DEATH_SIGNAL = 1  # prctl(2), PR_SET_PDEATHSIG
_EXIT_TIMEOUT_S = 1.0
_TAIL = 4096  # bytes of its output that are searched for its last words
_COLOUR = re.compile(r"\x1b\[[\d;]*m")


class ChildProcess:
    """A process in a session of its own, with its output in `folder/output.txt`.

    Ctrl-C does not reach it. On Linux it ends when this process is killed; elsewhere only `close` ends it.
    """

    def __init__(self, command: Sequence[str], folder: Path, environment: Mapping[str, str]) -> None:
        self._output = folder / "output.txt"
        self._cores: set[int] = set()
        with self._output.open("wb") as output:
            self._process = subprocess.Popen(
                command,
                cwd=folder,
                env=dict(environment),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=die_with_parent,
            )

    @property
    def ending(self) -> str:
        """Cause of its end in words; empty while it runs."""
        status = self._process.poll()
        if status is None:
            return ""
        return f"ended by {signal.Signals(-status).name}" if status < 0 else f"ended with status {status}"

    @property
    def last_words(self) -> str:
        """Last line of its output that has any letters; empty if there is none."""
        return self._last_lines(1)

    def _last_lines(self, count: int) -> str:
        with self._output.open("rb") as output:
            output.seek(max(self._output.stat().st_size - _TAIL, 0))
            lines = _COLOUR.sub("", output.read().decode(errors="replace")).splitlines()
        return "; ".join([line.strip() for line in lines if any(map(str.isalpha, line))][-count:])

    def share_core(self) -> None:
        """Pin it and this process to one core until it ends.

        On two cores datagrams of two links can overtake each other, and two flights differ.
        """
        with contextlib.suppress(OSError, AttributeError):
            self._cores = os.sched_getaffinity(0)
        share_core([os.getpid(), self._process.pid])

    def has_said(self, words: bytes) -> bool:
        """Return whether its output holds some words."""
        return words in self._output.read_bytes()

    def wait_for_ending(self) -> str:
        """Return the cause of its end, soon after its link has ended."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_EXIT_TIMEOUT_S)
        return self.ending

    def describe_ending(self, gone: str, lines: int = 1) -> str:
        """Return the cause of its end, `gone` if it still runs, and the last lines of its output."""
        return f"{self.wait_for_ending() or gone}; it said last: {self._last_lines(lines) or 'nothing'}"

    def close(self) -> None:
        """End it and all processes of its session."""
        for kind in (signal.SIGTERM, signal.SIGKILL):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, kind)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(_EXIT_TIMEOUT_S)
        if self._cores:
            os.sched_setaffinity(0, self._cores)


def share_core(pids: Sequence[int]) -> None:
    """Pin processes that alternate to the core of the first: to wake another core takes longer."""
    with contextlib.suppress(OSError, AttributeError):  # a system without this call goes on without it
        fields = Path(f"/proc/{pids[0]}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        for pid in pids:
            os.sched_setaffinity(pid, (int(fields[36]),))  # the core that it ran on last


def die_with_parent() -> None:
    """Have this process killed when the one that started it ends, where the system can; called before its program."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGKILL)
