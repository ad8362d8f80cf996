"""Errors that a person can mend: what is wrong, in one line."""


class ConfigError(Exception):
    """A vehicle, scenario or command line is wrong; the text is one line: where, what, what is allowed."""


class RecordingError(Exception):
    """What is flown can't be written down, as on a full disk; the text is one line: where, what."""
