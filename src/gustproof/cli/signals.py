"""Signals of the command line: Ctrl-C, SIGTERM, and SIGHUP of a terminal that closes end a command in order."""

# Until a handler stands Ctrl-C shows Python's own lines. So nothing is imported that Python has not loaded by then:
# `signal` wraps `_signal` in enumerations, `typing` and `types` are slow too.
import _signal as signal  # type: ignore[import-not-found]
import os
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import FrameType

_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
_INTERRUPTED = 130  # `ExitStatus.INTERRUPTED`, which takes longer to import than a signal may take to come
_CALLBACKS = "llvmlite"  # calls back from C, where an exception is printed and lost
_POSTPONED_S = 0.02


def end_at_once() -> None:
    """Let a signal end the process by itself, with one line: for when nothing has begun, or all is done."""
    _handle(_end)


def interrupt_commands() -> None:
    """Let a signal raise `KeyboardInterrupt`, as Ctrl-C does."""
    _handle(_interrupt)
    if hasattr(signal, "SIGALRM"):
        signal.signal(signal.SIGALRM, _interrupt)


def _handle(handler: object) -> None:
    for name in _NAMES:
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:  # as nohup and shells set it
            signal.signal(number, handler)


def _end(*_: object) -> None:
    os.write(2, b"gustproof: interrupted\n")
    os._exit(_INTERRUPTED)


def _interrupt(_: int, frame: "FrameType | None") -> None:
    """Raise `KeyboardInterrupt`, but later if machine code is being made."""
    if hasattr(signal, "setitimer") and _is_called_back(frame):
        signal.setitimer(signal.ITIMER_REAL, _POSTPONED_S)
        return
    raise KeyboardInterrupt


def _is_called_back(frame: "FrameType | None") -> bool:
    if _CALLBACKS not in sys.modules:
        return False
    while frame is not None:
        if frame.f_globals.get("__name__", "").startswith(_CALLBACKS):
            return True
        frame = frame.f_back
    return False
