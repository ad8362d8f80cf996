"""Delays as linear systems: of an uncertain time, and before the controls of a generalised plant."""

import math

import numpy as np

from gustproof.robust.lti.state_space import LinearSystem, Lti, as_lti, delay, gain, series
from gustproof.robust.uncertain.uncertain_system import Uncertain, as_uncertain, stack, system_from_matrix

_WHOLE = 1e-6
"""[-] largest distance of a delay from a whole number of samples."""


def uncertain_delay(delay: Uncertain, *, order: int = 2) -> Uncertain:
    """Return a delay of an uncertain, positive time [s] as its diagonal Pade approximant, one channel.

    Its phase is exact to 1 deg up to omega delay = .6 at order 1 and 1.7 at order 2; Delta needs `order` repetitions.

    References
    ----------
    G. H. Golub, C. F. Van Loan, Matrix Computations, 4th edition 2013, Eq. 9.3.1 (coefficients).

    Examples
    --------
    >>> from gustproof import uncertain_delay, ureal
    >>> link = uncertain_delay(ureal("delay", range=(0.01, 0.05)))
    >>> (link.M.order, link.blocks[0].repeats)
    (2, 2)
    """
    n = order
    falling = [math.factorial(2 * n - k) // (math.factorial(k) * math.factorial(n - k)) for k in range(n + 1)]
    denominator = np.array(falling, dtype=np.float64) / falling[n]
    numerator = denominator * (-1.0) ** np.arange(n + 1)
    A = np.vstack([np.eye(n)[1:], -denominator[:n]])
    C, D = (numerator - numerator[n] * denominator)[:n], numerator[n]
    # for 1 s; time scales with the delay: x' = (A x + B u) / delay
    unit = np.block([[A, np.eye(n)[:, -1:]], [C[None], np.array([[D]])]])
    return system_from_matrix(stack(*[delay.inverse()] * n, 1.0) @ unit, n)


def delay_controls(P: LinearSystem, n_con: int, seconds: float, *, order: int = 2) -> Lti:
    """Return the plant with its last `n_con` inputs delayed by `seconds`, for any synthesis.

    A sampled plant gets that many samples of delay: exact. A continuous one gets Pade's diagonal approximant of the
    given order. Its gain is exact. Its phase is exact to 1 deg up to `omega seconds` = .6 at order 1, 1.7 at order 2
    and 3.0 at order 3. A loop with gain beyond that frequency needs a higher order, or a sampled plant.

    Raises
    ------
    ValueError
        If the delay is not positive, or not a whole number of samples.

    Examples
    --------
    >>> from control import ss
    >>> from gustproof import delay_controls, hinfstruct
    >>> plant = ss([[1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 0.1], [0, 0.1, 0]])
    >>> late = delay_controls(plant, 1, 0.05)
    >>> f"{hinfstruct(plant, 1, 1, starts=1).norm:.2f} becomes {hinfstruct(late, 1, 1, starts=1).norm:.2f}"
    '0.15 becomes 0.20'
    """
    G = as_lti(P)
    if not (np.isfinite(seconds) and seconds > 0.0):
        raise ValueError(f"the delay is {seconds!r} s, must be positive")
    if G.dt:
        samples = round(seconds / G.dt)
        if samples < 1 or abs(seconds / G.dt - samples) > _WHOLE:
            raise ValueError(f"the delay is {seconds} s, must be a whole number of samples of {G.dt} s")
        late = delay(n_con, G.dt)
        for _ in range(samples - 1):
            late = series(late, delay(n_con, G.dt))
    else:
        late = stack(*[uncertain_delay(as_uncertain([[seconds]]), order=order)] * n_con).M
    return series(stack(gain(np.eye(G.n_inputs - n_con), G.dt), late).M, G)
