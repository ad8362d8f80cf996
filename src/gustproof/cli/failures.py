"""Exit statuses, and failures as one line on stderr."""

import errno
import re
import sys
from contextvars import copy_context
from enum import IntEnum
from typing import Any, cast

import typer
from typer.core import TyperGroup

from firmware_model.config.validation import did_you_mean, none_of, printable
from firmware_model.errors import ConfigError
from gustproof.cli import signals
from gustproof.errors import DesignError, FlightError

# The error of wrong options, of typer's own copy of click or of the package, whichever this typer has.
_UsageError = cast("type[typer.BadParameter]", typer.BadParameter.__bases__[0])
_LIMITS = {  # raised without a file's name: of writes only those to standard output
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT, errno.EFBIG), "standard output: {}"),
    **dict.fromkeys((errno.EMFILE, errno.ENFILE), "{}: allow more, by ulimit -n 1024"),
    **dict.fromkeys((errno.EAGAIN, errno.ENOMEM), "no further process or memory: {}"),
}


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
        """Run the subcommand; an unexpected error still shows its traceback.

        From here on a signal ends it in order. Before, nothing has begun that would need it.
        """
        try:
            signals.interrupt_commands()
            return copy_context().run(super().invoke, ctx)  # --force holds for this command alone
        except (ConfigError, DesignError) as error:
            raise exit_with(str(error), ExitStatus.BAD_INPUT) from None
        except FlightError as error:
            raise exit_with(str(error), ExitStatus.FLIGHT_BROKE_OFF) from None
        except _UsageError as error:
            if not error.message:  # a group without a command has shown its help
                raise
            raise _UsageError(_with_nearest(printable(_with_given(error)), _modes(error.ctx)), error.ctx) from None
        except KeyboardInterrupt:
            raise exit_with("interrupted", ExitStatus.INTERRUPTED) from None
        except OSError as error:
            if error.filename is None and error.errno not in _LIMITS:  # not about a named file: unexpected
                raise
            line = f"{error.filename}: {{}}" if error.filename is not None else _LIMITS[error.errno or 0]
            raise exit_with(line.format(error.strerror), ExitStatus.BAD_INPUT) from None


def _with_given(error: typer.BadParameter) -> str:
    """Return the text of a usage error, with the word that is wrong if it does not show that itself."""
    message, cause = error.format_message(), cast(Any, error.__cause__ or error.__context__)
    inputs = [item["input"] for item in cause.errors()] if hasattr(cause, "errors") else []
    return message + "".join(f" (given '{text}')" for text in inputs if f"'{text}'" not in message)


_FORMATS = {"--ulog": "flight.ulg", "--junit": "junit.xml", "--csv": "table.csv", "--latex": "table.tex"}
"""Files that other programs have an option for; here the suffix says what is written."""
_UNASKED = {"--autopilots": "gustproof doctor finds them in any case"}
"""Options for what a command does without one."""


def _modes(context: Any) -> list[str]:
    """Return the subcommands of the command that a usage error is about; those of `gustproof` itself are too many."""
    return list(getattr(context.command, "commands", ())) if context is not None and context.parent else []


def _with_nearest(message: str, modes: list[str]) -> str:
    """Return the text of a usage error; of a wrong subcommand or choice, with the right ones."""
    message = message.replace("Value error, ", "")
    if (option := re.match(r"No such option: (--\w+)", message)) and option[1] in _FORMATS:
        return f"No such option: {option[1]}; the suffix of a file says what is written: -o {_FORMATS[option[1]]}"
    if option and option[1] in _UNASKED:
        return f"No such option: {option[1]}; {_UNASKED[option[1]]}"
    if modes and (unknown := re.match(r"No such command '([^']*)'", message)):
        return none_of(unknown[1], modes)
    found = re.search(r"'([^']*)' is not one of (.*?)\.?$", message)
    return message + did_you_mean(found[1], re.findall(r"'([^']*)'", found[2])) if found else message


def say(line: str) -> None:
    """Print a line with text from a file, without control characters: the file may come from anywhere."""
    print(printable(line))


def exit_with(line: str, status: ExitStatus) -> typer.Exit:
    """Print one line on stderr and return the exception that ends the command with `status`."""
    print(f"gustproof: {printable(line)}", file=sys.stderr)
    return typer.Exit(status.value)
