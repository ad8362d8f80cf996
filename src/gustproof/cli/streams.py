"""Standard streams as they come: closed, full, or in an encoding without our signs."""

import codecs
import errno
import io
import os
import sys
from contextlib import suppress

_SPELT = {
    "≤": "<=",
    "≥": ">=",
    "°": " deg",
    "×": "x",
    "·": "*",
    "µ": "u",
    "±": "+-",
    "∞": "inf",
    "√": "sqrt",
    "–": "-",
    "−": "-",
    "…": "...",
}
"""Signs that an encoding may lack, and how they are spelt."""


def _spell(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(_SPELT.get(sign, "?") for sign in error.object[error.start : error.end]), error.end


SPELT = "spelt"
"""Handler of signs that an encoding lacks."""
codecs.register_error(SPELT, _spell)


class _Tolerant(io.TextIOWrapper):
    """Standard error that drops what can't be written: a lost remark must not end a flight."""

    def write(self, text: str) -> int:
        with suppress(OSError):
            return super().write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(OSError):
            super().flush()


def prepare() -> None:
    """Open closed streams on the null device, so that no file takes their place, and let no sign be an error."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number, which is this one
            raw = open(number, "r+b" if number else "rb", buffering=0, closefd=False)  # noqa: SIM115
            setattr(sys, name, io.TextIOWrapper(raw, write_through=True))  # another in its place leaves the file open
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors=SPELT)
    if isinstance(sys.stderr, io.TextIOWrapper):
        encoding = sys.stderr.encoding
        sys.stderr = _Tolerant(sys.stderr.detach(), encoding, "backslashreplace", line_buffering=True)


def flush() -> str:
    """Write what standard output holds back; return why it can't be written, if a reader has not just gone."""
    try:
        sys.stdout.flush()
    except OSError as error:
        with suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # else Python complains once more
        return "" if error.errno == errno.EPIPE else f"standard output: {error.strerror}"
    return ""
