"""Errors that a person can mend: what is wrong, in one line."""


class ConfigError(Exception):
    """A vehicle, scenario or command line is wrong; the text is one line: where, what, what is allowed.

    Examples
    --------
    >>> from gustproof import ConfigError, load_law
    >>> try:
    ...     load_law("no-such-law")
    ... except ConfigError as error:
    ...     print(str(error).partition(":")[0])
    no law named 'no-such-law'
    """


class RecordingError(Exception):
    """What is flown can't be written down, as on a full disk; the text is one line: where, what."""
