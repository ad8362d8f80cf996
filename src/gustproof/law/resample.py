"""A law at another sample time, by Tustin's rule backwards and forwards.

The rule is invertible, so a central law becomes exactly what `central_law` would have made at the new rate: states,
kinematics and frequency response keep their continuous origin. Of a law on strapdown attitude only what follows the
strapdown is mapped. Attitude and rate stay the trapezoidal rule, at the new sample time.

What happens at limits keeps one sample of delay: an excess never changes the sum that it was taken from at once.
"""

from dataclasses import replace

import numpy as np

from firmware_model.config.scenario import sample_time
from gustproof.errors import DesignError
from gustproof.law.form import Law, Matrix, RateLimit
from gustproof.robust.lti.bilinear import tustin
from gustproof.robust.lti.state_space import Lti

_TOLERANCE = 1e-9
"""[-] relative distance from the strapdown form that counts as rounding."""
_FASTEST = 1e5
"""[Hz] rate whose samples are ten microseconds."""
_ATTITUDE, _RATE, _REST = slice(0, 3), slice(3, 6), slice(6, None)
"""States of a law on strapdown attitude."""


def resample(law: Law, rate: float) -> Law:
    """Return the law at `rate` [Hz], named after it; at its own rate the law itself.

    Samples last whole microseconds, as stamps do: 3333 at 300 Hz.

    Raises
    ------
    ValueError
        If the rate is not positive, or more than a clock of microseconds tells.
    DesignError
        If the law has a pole at -1, or its continuous origin one at twice the rate: there the rule is singular.

    References
    ----------
    A. Tustin, A method of analysing the behaviour of linear systems in terms of time series, JIEE 94 (1947), 130-142.
    P. G. Savage, Strapdown Inertial Navigation Integration Algorithm Design Part 1, JGCD 21 (1998), 19-28.

    Examples
    --------
    >>> from gustproof import load_law, resample
    >>> faster = resample(load_law("flagship"), 400.0)
    >>> (faster.name, faster.dt)
    ('flagship-400hz', 0.0025)
    """
    if not 0.0 < rate <= _FASTEST:
        raise ValueError(f"the rate is {rate} Hz, must be positive and at most {_FASTEST:g}")
    own, dt = 1.0 / law.dt, sample_time(rate)
    if abs(dt - law.dt) < _TOLERANCE * law.dt:
        return law
    strapdown = law.schedule is None and _is_strapdown(law)
    moved = _resample_strapdown(law, dt) if strapdown else _resample_whole(law, dt)
    design = f"{law.provenance.design}; resampled from {own:g} Hz by Tustin's rule"
    return replace(
        moved, name=f"{law.name}-{rate:g}hz".replace(".", "_"), provenance=replace(law.provenance, design=design)
    )


def continuous_origin(K: Lti) -> Lti:
    """Return the continuous controller that `tustin` maps to `K`, with its states."""
    n, dt = K.order, float(K.dt or 0.0)
    M = 0.5 * (K.A + np.eye(n))
    if n and np.linalg.cond(M) > 1e12:
        raise DesignError("the law has a pole at -1, it has no continuous origin")
    implicit = np.linalg.inv(M)
    C = K.C @ implicit
    B = implicit @ K.B / dt
    return Lti(A=2.0 / dt * (np.eye(n) - implicit), B=B, C=C, D=K.D - 0.5 * dt * K.C @ B)


def _resample_whole(law: Law, dt: float) -> Law:
    """Return a law without strapdown; its rate commanded from attitude is of the states, so it stays."""
    n, m, none = law.order, law.D.shape[1], np.zeros((3, 3))
    limit, turn = law.rate_limit, law.schedule
    k = 0 if turn is None else len(turn.parameters)
    P, Q, rows = none[:, :0], np.zeros((n, 0)), np.zeros((0, n + m + k))
    if turn is not None:
        P, Q, rows = turn.P, turn.Q, np.hstack([turn.J, turn.K, turn.L])
    J, K, L = np.split(rows, [n, n + m], axis=1)
    U, V = (none, np.zeros((n, 3))) if limit is None else (limit.U, limit.V)
    rates = np.eye(3, n, 3)
    sampled = Lti(
        A=law.A + law.G @ rates,
        B=np.hstack([law.B, law.G, V, law.H, Q]),
        C=np.vstack([law.C, J]),
        D=np.block([[law.D, none, U, none, P], [K, np.zeros((k, 9)), L]]),
        dt=law.dt,
    )
    moved = tustin(continuous_origin(sampled), dt)
    B, G, V, H, Q = np.split(moved.B, [m, m + 3, m + 6, m + 9], axis=1)
    limit = None if limit is None else replace(limit, U=moved.D[:3, m + 3 : m + 6], V=V)
    if turn is not None:
        K, L, P = moved.D[3:, :m], moved.D[3:, m + 9 :], moved.D[:3, m + 9 :]
        turn = replace(turn, J=moved.C[3:], K=K, L=L, P=P, Q=Q)
    G, H = _kept_zero(G, law.G), _kept_zero(H, law.H)
    law = replace(law, A=moved.A - G @ rates, B=B, C=moved.C[:3], D=moved.D[:3, :m], G=G, H=H, dt=dt, rate_limit=limit)
    return replace(law, schedule=turn)


def _kept_zero(moved: Matrix, own: Matrix) -> Matrix:
    """Return an input matrix, exactly 0 where the law has no such input."""
    return moved if own.any() else np.zeros_like(own)


def _is_strapdown(law: Law) -> bool:
    """Return whether attitude and rate are the gyro's trapezoid, and all else reads them at the gyro's time.

    `x0+ = x0 + dt T(x0) x1 + dt/2 (g - x1)` and `x1+ = g`; every other sum takes the attitude `x0 + dt/2 (x1 + g)`.
    """
    n, half = law.order, 0.5 * law.dt
    if n < 6 or law.uses_accelerometer:
        return False
    own = np.zeros((6, n + law.D.shape[1] + 3))
    for i in range(3):
        own[i, [i, 3 + i, n + i, n + 6 + i]] = 1.0, -half, half, law.dt
        own[3 + i, n + i] = 1.0
    first = np.hstack([law.A[:6], law.B[:6], law.G[:6]])
    limit = law.rate_limit
    rows = [law.A[6:], law.C] if limit is None else [law.A[6:], law.C, limit.S]
    fed = any(part[:6].any() for part in (law.H, np.zeros((6, 3)) if limit is None else limit.V))
    telescopes = all(np.allclose(row[:, _RATE], half * row[:, _ATTITUDE], rtol=_TOLERANCE, atol=0.0) for row in rows)
    return bool(np.array_equal(first, own) and telescopes and not fed and not law.G[6:].any())


def _resample_strapdown(law: Law, dt: float) -> Law:
    n, limit = (
        law.order,
        law.rate_limit
        or RateLimit(
            S=np.eye(3, law.order),
            T=np.zeros((3, 6)),
            U=np.zeros((3, 3)),
            V=np.zeros((law.order, 3)),
            limits=np.ones(3),
        ),
    )
    states = np.vstack([law.A[6:], law.C, limit.S])
    inputs = np.vstack([law.B[6:], law.D, limit.T])
    attitude = states[:, _ATTITUDE]
    inputs = inputs - 0.5 * law.dt * np.hstack([attitude, np.zeros_like(attitude)])
    excess = np.vstack([np.hstack([limit.V[6:], law.H[6:]]), np.hstack([limit.U, np.zeros((3, 3))]), np.zeros((3, 6))])
    columns, order = np.hstack([attitude, inputs, excess]), n - 6
    rest = Lti(A=states[:order, _REST], B=columns[:order], C=states[order:, _REST], D=columns[order:], dt=law.dt)
    moved = tustin(continuous_origin(rest), dt)
    columns = np.vstack([moved.B, moved.D])
    attitude, inputs, V, H = np.split(columns, [3, 9, 12], axis=1)
    states = np.hstack([attitude, 0.5 * dt * attitude, np.vstack([moved.A, moved.C])])
    inputs = inputs + 0.5 * dt * np.hstack([attitude, np.zeros_like(attitude)])
    one, no = np.eye(3), np.zeros((3, 3))
    A = np.vstack([np.hstack([one, -0.5 * dt * one, np.zeros((3, order))]), np.zeros((3, n)), states[:order]])
    B = np.vstack([np.hstack([0.5 * dt * one, no]), np.hstack([one, no]), inputs[:order]])
    below = np.zeros((6, 3))
    moved_limit = law.rate_limit and replace(
        limit, S=states[order + 3 :], T=inputs[order + 3 :], U=V[order : order + 3], V=np.vstack([below, V[:order]])
    )
    return replace(
        law,
        A=A,
        B=B,
        C=states[order : order + 3],
        D=inputs[order : order + 3],
        G=np.vstack([dt * one, np.zeros((n - 3, 3))]),
        H=np.vstack([below, H[:order]]),
        dt=dt,
        rate_limit=moved_limit,
    )
