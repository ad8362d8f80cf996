"""The command `gustproof`, also run as `python -m gustproof`."""

import atexit
import gc
import os
import signal


def main() -> None:
    """Run the command line.

    SIGTERM acts as Ctrl-C: no process stays behind, and no file is left half written.
    """
    # Matrices here are small: BLAS threads would wait for each other longer than they compute.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.set_threshold(100_000)  # what is imported stays: to look for garbage in it takes a sixth of the start
    atexit.register(gc.freeze)  # nor is it looked through at the end
    from gustproof.cli.app import app

    signal.signal(signal.SIGTERM, signal.default_int_handler)
    app(prog_name="gustproof")


if __name__ == "__main__":
    main()
