"""Errors of the engineer's side; each text is one line."""


class DesignError(Exception):
    """No controller exists at this level, or the problem is ill posed; the text names the failed condition.

    Examples
    --------
    >>> from control import ss
    >>> from gustproof import DesignError, hinfsyn
    >>> try:
    ...     hinfsyn(ss([[1.0]], [[1.0, 1.0]], [[1.0], [1.0]], [[0.0, 0.0], [0.0, 0.0]]), n_meas=1, n_con=1)
    ... except DesignError as error:
    ...     print(error)
    D12 lacks full column rank: control 1 is not weighted in z
    """


class FlightError(Exception):
    """A flight that others depend on did not reach its end; the text is one line: flight, outcome, reason."""
