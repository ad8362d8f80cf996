"""Exit statuses, and failures as one line on stderr."""

import errno
import re
import sys
from enum import IntEnum
from typing import Any, cast

import typer
from typer.core import TyperGroup

from firmware_model.config.validation import did_you_mean, printable
from firmware_model.errors import ConfigError
from gustproof.errors import DesignError, FlightError

# The error of wrong options, of typer's own copy of click or of the package, whichever this typer has.
_UsageError = cast("type[typer.BadParameter]", typer.BadParameter.__bases__[0])
_DISK_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}  # raised by writes, without a file's name


class ExitStatus(IntEnum):
    """Exit status of a command."""

    DONE = 0  # success
    REQUIREMENT_FAILED = 1  # the command ran to its end, and a stated requirement failed
    BAD_INPUT = 2  # a file, a name or an option is wrong, or the design has no controller
    FLIGHT_BROKE_OFF = 3  # a flight did not reach its end
    INTERRUPTED = 130  # Ctrl-C, with the number that shells use


class OneLineErrors(TyperGroup):
    """Group of subcommands whose expected failures print one line instead of a traceback."""

    def invoke(self, ctx: Any) -> Any:
        """Run the subcommand; an unexpected error still shows its traceback."""
        try:
            return super().invoke(ctx)
        except (ConfigError, DesignError) as error:
            raise exit_with(str(error), ExitStatus.BAD_INPUT) from None
        except FlightError as error:
            raise exit_with(str(error), ExitStatus.FLIGHT_BROKE_OFF) from None
        except _UsageError as error:
            raise _UsageError(_with_nearest(printable(error.format_message())), error.ctx) from None
        except KeyboardInterrupt:
            raise exit_with("interrupted", ExitStatus.INTERRUPTED) from None
        except OSError as error:
            if error.filename is None and error.errno not in _DISK_FULL:  # not about a named file: unexpected
                raise
            named = "" if error.filename is None else f"{error.filename}: "
            raise exit_with(f"{named}{error.strerror}", ExitStatus.BAD_INPUT) from None


def _with_nearest(message: str) -> str:
    """Return the text of a usage error; of a wrong choice, with the nearest right one."""
    message = message.replace("Value error, ", "")
    found = re.search(r"'([^']*)' is not one of (.*?)\.?$", message)
    return message + did_you_mean(found[1], re.findall(r"'([^']*)'", found[2])) if found else message


def say(line: str) -> None:
    """Print a line with text from a file, without control characters: the file may come from anywhere."""
    print(printable(line))


def exit_with(line: str, status: ExitStatus) -> typer.Exit:
    """Print one line on stderr and return the exception that ends the command with `status`."""
    print(f"gustproof: {printable(line)}", file=sys.stderr)
    return typer.Exit(status.value)
