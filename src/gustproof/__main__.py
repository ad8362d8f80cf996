"""`python -m gustproof` and the command `gustproof`."""

from gustproof.cli.app import app


def main() -> None:
    """Run the command line."""
    app(prog_name="gustproof")


if __name__ == "__main__":
    main()
