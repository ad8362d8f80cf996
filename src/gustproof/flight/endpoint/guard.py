"""`python -m gustproof.flight.endpoint.guard WORD...`: a program that speaks MAVLink, and what it starts.

The vehicle's address comes as the first line of standard input. The program finds it in `GUSTPROOF_ADDRESS`, and in
place of `{address}` in its words. It ends by SIGTERM, later SIGKILL, to its whole process group. That is done as soon
as this process gets SIGTERM, or its input ends because its starter was killed. SIGQUIT kills at once.
"""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from tempfile import TemporaryFile
from typing import IO, Any

from firmware_model.config.validation import sanitize_line
from firmware_model.process.child import die_with_parent
from firmware_model.process.exit_on_eof import exit_on_stdin_eof

ADDRESS_VARIABLE = "GUSTPROOF_ADDRESS"
"""Environment variable that holds the vehicle's address, as 127.0.0.1:14580."""
_PLACEHOLDER = "{address}"
_EXIT_TIMEOUT_S = 2.0  # from SIGTERM to SIGKILL
_TAIL = 4096  # bytes of what it said that are searched for its last line
_INTERRUPTED = 130


def main(words: Sequence[str]) -> int:
    """Run a program until it ends or is to end; return its exit status, and print how it ended as JSON."""
    address = sys.stdin.readline().strip()
    if not address:
        return _INTERRUPTED
    with TemporaryFile() as said:
        program = _start([word.replace(_PLACEHOLDER, address) for word in words], address, said)
        # A program that ignores SIGTERM gets SIGKILL when the alarm rings.
        signal.signal(signal.SIGALRM, lambda *_: _signal_group(program, signal.SIGKILL))
        signal.signal(signal.SIGQUIT, lambda *_: _signal_group(program, signal.SIGKILL))
        signal.signal(signal.SIGTERM, lambda *_: _end(program))
        exit_on_stdin_eof(lambda: os.kill(os.getpid(), signal.SIGTERM))
        status = _wait(program)
        _signal_group(program, signal.SIGKILL)  # what it started and left
        ended = {"status": status, "message": f"'{words[0]}' {describe_exit(status)}{_last_line(said)}"}
        sys.stdout.write(f"{json.dumps(ended)}\n")
    return status if status >= 0 else 128 - status


def _start(words: Sequence[str], address: str, said: IO[bytes]) -> "subprocess.Popen[Any]":
    return subprocess.Popen(
        words,
        env={**os.environ, ADDRESS_VARIABLE: address},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=said,
        start_new_session=True,
        preexec_fn=die_with_parent,
    )


def _wait(program: "subprocess.Popen[Any]") -> int:
    """Return the status of a program when it has ended.

    A signal just before `Popen.wait` would only be handled after it. So each signal writes to a pipe that is read.
    """
    told, tell = os.pipe()
    os.set_blocking(tell, False)
    signal.set_wakeup_fd(tell, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)  # it is ignored else, and writes nothing
    while (status := program.poll()) is None:
        os.read(told, 1)
    return status


def _end(program: "subprocess.Popen[Any]") -> None:
    _signal_group(program, signal.SIGTERM)
    signal.setitimer(signal.ITIMER_REAL, _EXIT_TIMEOUT_S)


def _signal_group(program: "subprocess.Popen[Any]", number: signal.Signals) -> None:
    with suppress(ProcessLookupError, PermissionError):  # a group that has ended; macOS names it so
        os.killpg(program.pid, number)


def describe_exit(status: int) -> str:
    """Return in words how a process ended, by its status."""
    return f"was ended by {signal.Signals(-status).name}" if status < 0 else f"ended with status {status}"


def _last_line(said: IO[bytes]) -> str:
    """Return the last line that the program wrote to its standard error, behind a colon; empty if there is none."""
    said.seek(max(said.seek(0, os.SEEK_END) - _TAIL, 0))
    lines = [line.strip() for line in said.read().decode(errors="replace").splitlines()]
    last = next(filter(None, reversed(lines)), "")
    return f": {sanitize_line(last)}" if last else ""


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
