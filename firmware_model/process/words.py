"""Options of a process that another one starts: `--name value`, or `--name` alone for what is on or off.

People get them from the command line of `gustproof`, with help; here nothing is imported for that.
"""

from collections.abc import Sequence
from typing import Any, TypeVar, get_type_hints

from firmware_model.config.files import validate
from firmware_model.config.validation import did_you_mean, sanitize_line
from firmware_model.errors import ConfigError

Options = TypeVar("Options")


def read_words(kind: type[Options], words: Sequence[str]) -> Options:
    """Return the options in the words of a command, as a `kind`, a dataclass with a field for each.

    Raises
    ------
    ConfigError
        If an option is unknown, lacks its value, or its value is not allowed.
    """
    types, waiting = get_type_hints(kind), iter(words)
    given: dict[str, Any] = {}
    for word in waiting:
        name = word.removeprefix("--").replace("-", "_")
        if not word.startswith("--") or name not in types:
            near = did_you_mean(word, (f"--{each.replace('_', '-')}" for each in types))
            raise ConfigError(f"no such option: {sanitize_line(word)}{near}")
        given[name] = True if types[name] is bool else next(waiting, None)
        if given[name] is None:
            raise ConfigError(f"{word}: its value is missing")
    return validate(kind, given, "options")
