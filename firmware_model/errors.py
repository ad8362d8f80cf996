"""Errors that a user can fix, each with its cause in one line."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path


class ConfigError(Exception):
    """Wrong vehicle, scenario or command line; the text is one line: where, what, what is allowed.

    Examples
    --------
    >>> from gustproof import ConfigError, load_law
    >>> try:
    ...     load_law("no-such-law")
    ... except ConfigError as error:
    ...     print(str(error).partition(":")[0])
    no law named 'no-such-law'
    """


class ConfigErrors(ConfigError):
    """Several errors in one file; the text joins them in one line, `lines` holds one line for each."""

    def __init__(self, source: str, errors: Sequence[str]) -> None:
        super().__init__(source, errors)
        self.lines = [f"{source}: {error}" for error in errors]
        self._text = f"{source}: {'; '.join(errors)}"

    def __str__(self) -> str:
        return self._text


class RecordingError(Exception):
    """Failure to write a recording, such as a full disk; the text is one line: where, what."""


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Name `path` in an OSError raised while it is written; a full disk does not name it by itself."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None
