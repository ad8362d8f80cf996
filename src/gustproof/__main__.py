"""The command `gustproof`, also run as `python -m gustproof`."""

import atexit
import gc
import os
import sys


def _leave_current_folder() -> None:
    """Take the current folder off the path, where `python -m` puts it first: no file there may pass for a module."""
    try:
        here = os.getcwd()  # noqa: PTH109  # pathlib would be looked for there
    except FileNotFoundError:
        return
    if not sys.flags.safe_path and sys.path[0] == here:
        del sys.path[0]


if __name__ == "__main__":
    _leave_current_folder()  # before any other import

from gustproof.cli import signals  # noqa: E402

_BAD_OUTPUT = 2


def main() -> None:
    """Run the command line.

    SIGTERM and SIGHUP act as Ctrl-C: no process stays behind, and no file is left half written.
    """
    signals.end_at_once()
    from gustproof.cli import streams

    streams.prepare()
    # Matrices here are small: BLAS threads would wait for each other longer than they compute.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.set_threshold(100_000)  # what is imported stays: to look for garbage in it takes a sixth of the start
    atexit.register(gc.freeze)  # nor is it looked through at the end
    from gustproof.cli.app import app

    status: object = 0
    try:
        app(prog_name="gustproof")
    except SystemExit as end:
        status = end.code
    finally:
        signals.end_at_once()
    if reason := streams.flush():
        print(f"gustproof: {reason}", file=sys.stderr)
        status = status or _BAD_OUTPUT
    raise SystemExit(status)


if __name__ == "__main__":
    main()
