"""`python -m gustproof` and the command `gustproof`."""

import os
import signal


def main() -> None:
    """Run the command line; being ended from outside is Ctrl-C, so that nothing is left running or half written."""
    # Matrices here are small: threads of BLAS would wait for each other, on a busy machine longer than they compute.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from gustproof.cli.app import app

    signal.signal(signal.SIGTERM, signal.default_int_handler)
    app(prog_name="gustproof")


if __name__ == "__main__":
    main()
