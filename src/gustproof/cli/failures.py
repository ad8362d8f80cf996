"""The one place that turns a failure into one line on stderr and an exit status."""

import errno
import sys
from enum import IntEnum
from typing import Any

import click
import typer
from typer.core import TyperGroup

from firmware_model.config.validation import printable
from firmware_model.errors import ConfigError
from gustproof.errors import DesignError, FlightError

ANYWAY = "Fly, too, what is refused: a law that is unstable on the vehicle, references that it does not hold."
"""Help of `--anyway`."""
_DISK_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}  # writing raises them, and does not say where


class ExitStatus(IntEnum):
    """Exit statuses."""

    DONE = 0
    """All went well."""
    REQUIREMENT_FAILED = 1
    """Everything ran, and a stated requirement was not met."""
    BAD_INPUT = 2
    """A file, a name or an option is wrong, or no controller exists as asked."""
    FLIGHT_BROKE_OFF = 3
    """A flight did not reach its end."""
    INTERRUPTED = 130
    """Ctrl-C, as shells count it."""


class OneLineErrors(TyperGroup):
    """A group of subcommands whose expected failures end in one clear line instead of a traceback."""

    def invoke(self, ctx: Any) -> Any:
        """Run the subcommand; what nobody expected still shows its traceback."""
        try:
            return super().invoke(ctx)
        except (ConfigError, DesignError) as error:
            raise exit_with(str(error), ExitStatus.BAD_INPUT) from None
        except FlightError as error:
            raise exit_with(str(error), ExitStatus.FLIGHT_BROKE_OFF) from None
        except click.UsageError as error:
            raise click.UsageError(printable(error.format_message()), error.ctx) from None
        except KeyboardInterrupt:
            raise exit_with("interrupted", ExitStatus.INTERRUPTED) from None
        except OSError as error:
            if error.filename is None and error.errno not in _DISK_FULL:  # not about a file that someone named
                raise
            named = "" if error.filename is None else f"{error.filename}: "
            raise exit_with(f"{named}{error.strerror}", ExitStatus.BAD_INPUT) from None


def say(line: str) -> None:
    """Print a line that holds words of a file, which may come from anywhere."""
    print(printable(line))


def exit_with(line: str, status: ExitStatus) -> typer.Exit:
    """Print one line on stderr and return the exception that ends the command with `status`."""
    print(f"gustproof: {printable(line)}", file=sys.stderr)
    return typer.Exit(status.value)
