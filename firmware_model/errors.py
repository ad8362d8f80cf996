"""Errors that a person who wrote a file or a command line can mend."""


class ConfigError(Exception):
    """A vehicle, scenario or command line is wrong; the text is one line: where, what, what is allowed."""
