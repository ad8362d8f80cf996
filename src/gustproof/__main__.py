"""`python -m gustproof` and the command `gustproof`."""

import signal

from gustproof.cli.app import app


def main() -> None:
    """Run the command line; being ended from outside is Ctrl-C, so that nothing is left running or half written."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    app(prog_name="gustproof")


if __name__ == "__main__":
    main()
