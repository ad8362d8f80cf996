"""Continuous images of discrete plants, of the same gains, and the way back for controllers."""

import numpy as np

from gustproof.errors import DesignError
from gustproof.robust.lti.bilinear import bilinear_transform
from gustproof.robust.lti.state_space import Lti

_NEAR_MINUS_ONE = 1e-3
"""[-] distance of a discrete pole from z = -1 within which the sign of z is changed."""


def continuous_image(P: Lti) -> Lti:
    """Return a plant of the same norms and controllers in continuous time, at a time unit of half a sample.

    A pole at z = -1 would go to infinity; `z -> -z` moves it to the origin.
    """
    if not P.dt:
        return P
    sign = _time_sign(P)
    return bilinear_transform(Lti(A=sign * P.A, B=sign * P.B, C=P.C, D=P.D, dt=2.0))


def _time_sign(P: Lti) -> float:
    """Return the sign of z with which no pole of the plant is near -1; raise if there is none."""
    poles = P.poles()
    distances = {sign: float(np.min(np.abs(sign * poles + 1.0))) for sign in (1.0, -1.0)}
    sign = 1.0 if distances[1.0] > _NEAR_MINUS_ONE else -1.0
    if distances[sign] <= _NEAR_MINUS_ONE:
        raise DesignError("P has poles at z = -1 and at z = 1: the bilinear map has no place for both")
    return sign


def discrete_original(K: Lti, P: Lti) -> Lti:
    """Return the controller of the discrete plant `P` for that of `continuous_image(P)`."""
    if not P.dt:
        return K
    n, sign = K.order, _time_sign(P)
    M = np.linalg.inv(np.eye(n) - K.A)
    A, B = sign * M @ (np.eye(n) + K.A), sign * 2.0**0.5 * M @ K.B
    return Lti(A=A, B=B, C=2.0**0.5 * K.C @ M, D=K.D + K.C @ M @ K.B, dt=P.dt)
