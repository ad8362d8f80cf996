"""Bilinear transformations of the frequency variable: Tustin's rule and its inverse, prewarped, and any other."""

import math

import numpy as np

from gustproof.errors import DesignError
from gustproof.robust.lti.state_space import Lti, Matrix


def bilinear(G: Lti, a: float, b: float, c: float, d: float, *, dt: float) -> Lti:
    """Return `G` with its variable replaced by `(a q + b) / (c q + d)`, as a system of sample time `dt` [s] in q.

    It moves the axis as well. `(1, -shift, 0, 1)` and `dt = 0` give `G(q - shift)`: a controller of that plant puts the
    poles of the loop with `G` below `-shift`. `(r, 0, 0, 1)` does the same for the radius r in discrete time.

    Raises
    ------
    ValueError
        If `a d - b c` is 0: the transformation is a constant.
    DesignError
        If `G` has a pole at `a / c`, which goes to infinity.

    References
    ----------
    M. G. Safonov, Imaginary-axis zeros in multivariable H-infinity optimal control, NATO workshop 1986, Theorem 1.

    Examples
    --------
    >>> from gustproof.robust.lti.bilinear import bilinear
    >>> from gustproof.robust.lti.state_space import Lti
    >>> float(bilinear(Lti(A=[[-3.0]], B=[[1.0]], C=[[1.0]], D=[[0.0]]), 1.0, -2.0, 0.0, 1.0, dt=0.0).A[0, 0])
    -1.0
    """
    if a * d == b * c:
        raise ValueError(f"a d - b c is 0 for ({a:g}, {b:g}, {c:g}, {d:g}): the transformation is a constant")
    identity = np.eye(G.order)
    implicit = a * identity - c * G.A
    if G.order and np.linalg.cond(implicit) > 1e12:
        raise DesignError(f"the system has a pole at {a / c:.4g}, which the bilinear transformation sends to infinity")
    inverse: Matrix = np.asarray(np.linalg.inv(implicit), dtype=np.float64)
    return Lti(
        A=inverse @ (d * G.A - b * identity),
        B=(a * d - b * c) * inverse @ G.B,
        C=G.C @ inverse,
        D=G.D + c * G.C @ inverse @ G.B,
        dt=dt,
    )


def tustin(G: Lti, dt: float, *, prewarp: float = 0.0) -> Lti:
    """Return a continuous system at the sample time `dt` [s] by the trapezoidal rule.

    The state is `x - dt/2 x'`: equal to that of `G` at rest, half a sample older in motion. So states keep their
    meaning, and an input matrix becomes `dt (I - A dt/2)^-1 B`. With `prewarp` [rad/s] both have the same response at
    that frequency.

    Raises
    ------
    ValueError
        If `prewarp` is not below the Nyquist frequency.
    DesignError
        If `G` has a pole at 2/dt, where the rule is singular.

    Examples
    --------
    >>> from gustproof.robust.lti.bilinear import tustin
    >>> from gustproof.robust.lti.state_space import Lti
    >>> float(tustin(Lti(A=[[-2.0]], B=[[2.0]], C=[[1.0]], D=[[0.0]]), 0.5).A[0, 0])
    0.3333333333333333
    """
    if not 0.0 <= prewarp * dt < math.pi:
        raise ValueError(f"prewarp is {prewarp:g} rad/s, must be below the Nyquist frequency {math.pi / dt:.4g} rad/s")
    step = 2.0 * math.tan(0.5 * prewarp * dt) / prewarp if prewarp else dt
    try:
        return bilinear(G, 1.0, -1.0, 0.5 * step, 0.5 * step, dt=dt)
    except DesignError:
        raise DesignError(f"a pole at 2/dt = {2.0 / step:.4g} rad/s: choose another sample time") from None


def bilinear_transform(G: Lti) -> Lti:
    """Return the continuous system with `G(z)` at `z = (1 + s dt/2) / (1 - s dt/2)`; gains and Gramians are kept.

    `G` must have no pole at z = -1.
    """
    n = G.order
    M, scale = np.linalg.inv(G.A + np.eye(n)), 2.0 / G.dt**0.5
    A = 2.0 / G.dt * M @ (G.A - np.eye(n))
    return Lti(A=A, B=scale * M @ G.B, C=scale * G.C @ M, D=G.D - G.C @ M @ G.B)
