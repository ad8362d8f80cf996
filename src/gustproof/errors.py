"""Errors of the engineer's side: what failed, in one line."""

from firmware_model.errors import ConfigError


class DesignError(Exception):
    """No controller at this level, or an ill-posed problem; the text names the condition that failed.

    Examples
    --------
    >>> from control import ss
    >>> from gustproof import DesignError, hinfsyn
    >>> try:
    ...     hinfsyn(ss([[1.0]], [[1.0, 1.0]], [[1.0], [1.0]], [[0.0, 0.0], [0.0, 0.0]]), n_meas=1, n_con=1)
    ... except DesignError as error:
    ...     print(error)
    D12 lacks full column rank: a control is not weighted in z
    """


class LawFileError(ConfigError):
    """A law file is wrong; the text is one line: file, key, what is allowed."""


class FlightError(Exception):
    """A flight that others depend on did not reach its end; the text is one line: which, how, why."""
