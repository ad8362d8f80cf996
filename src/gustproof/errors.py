"""Errors of the engineer's side: what failed, in one line."""

from firmware_model.errors import ConfigError


class DesignError(Exception):
    """No controller at this level, or an ill-posed problem; the text names the condition that failed."""


class LawFileError(ConfigError):
    """A law file is wrong; the text is one line: file, key, what is allowed."""


class FlightError(Exception):
    """A flight that others depend on did not reach its end; the text is one line: which, how, why."""
