"""H-infinity loop shaping by Glover and McFarlane: the widest margin of the coprime factors of a shaped plant."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from gustproof.errors import DesignError
from gustproof.robust.coprime.factors import coprime_factors
from gustproof.robust.hinf.checked_controller import ROUNDING_ERRORS, CheckedController, keep_names
from gustproof.robust.lti.bilinear import tustin
from gustproof.robust.lti.norms import Peak, hinf_norm
from gustproof.robust.lti.state_space import LinearSystem, Lti, as_controller, as_lti, lft, series

_ROUNDING = 1e-6
"""[-] relative excess of the norm over its level that counts as rounding: the level is met with equality."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ShapedController(CheckedController):
    """A loop-shaping controller `W1 K_s W2`, with the evidence of its shaped loop.

    `norm` is the H-infinity norm of `[K_s; I] (I - G_s K_s)^-1 [I, G_s]` with the shaped plant `G_s = W2 G W1`.

    Examples
    --------
    >>> from control import ss, tf
    >>> from gustproof import ncfsyn
    >>> f"{ncfsyn(ss(tf(1, [1, 0]))).emax:.4f}"
    '0.7071'
    """

    emax: float
    """[-] widest margin that any controller of the shaped plant has, `1 / gamma` at its least."""
    margin: float
    """[-] margin of this one, `b(G_s, K_s) = 1 / norm`: every plant within this gap of `G_s` is stabilised too."""


def ncfsyn(
    G: LinearSystem, W1: LinearSystem | None = None, W2: LinearSystem | None = None, *, backoff: float = 1.1
) -> ShapedController:
    """Return the loop-shaping controller of a plant, `u = K y` with `K = W1 K_s W2` (MATLAB: `ncfsyn`).

    Feedback is positive, as in MATLAB's `ncfsyn`; for weights chosen with negative feedback give `-W1` or negate `G`.
    `K_s` keeps the closed loop's norm within `backoff` times the least for normalised coprime factors. The shaped loop
    then stays stable for coprime factors that are wrong by up to `margin`. Margins above .25 are usual. The loop is
    checked with the matrices returned: its poles, then its norm.

    Parameters
    ----------
    G
        Plant, continuous or discrete, p outputs and m inputs.
    W1, W2
        Weights before the plant (m, m) and behind it (p, p), of the plant's sample time; `None` for 1.
    backoff
        [-] > 1, level over its least.

    Raises
    ------
    ValueError
        If `backoff` is not above 1, or sizes or sample times do not fit.
    DesignError
        If the shaped plant has no coprime factors, as when a weight cancels a pole on the axis. If rounding spoilt the
        controller.

    References
    ----------
    D. McFarlane, K. Glover, A loop shaping design procedure using H-infinity synthesis, IEEE TAC 37 (1992), 759-769.

    Examples
    --------
    >>> from control import ss, tf
    >>> from gustproof import ncfsyn
    >>> G = tf(200, [10, 1]) * tf(1, [0.0025, 0.1, 1])  # Skogestad and Postlethwaite, Example 9.3
    >>> result = ncfsyn(ss(G), ss(tf([1, 2], [1, 0])))
    >>> f"{1 / result.emax:.2f}, {result.order} states"
    '2.34, 5 states'
    """
    if not (np.isfinite(backoff) and backoff > 1.0):
        raise ValueError(f"backoff is {backoff!r}, must be above 1")
    plant = as_lti(G)
    before = _weight("W1", W1, plant, plant.n_inputs)
    behind = _weight("W2", W2, plant, plant.n_outputs)
    shaped = plant
    shaped = shaped if before is None else series(before, shaped)
    shaped = shaped if behind is None else series(shaped, behind)
    try:
        factors = coprime_factors(shaped)
        gamma = backoff * factors.least_gamma
        image = factors.robust_controller(gamma)
    except ROUNDING_ERRORS as error:
        raise DesignError(f"the shaped plant is too badly scaled to solve: {error}") from None
    robust = tustin(image, plant.dt) if plant.dt else image
    peak = check_shaped_loop(shaped, robust)
    if not peak.gain <= (1.0 + _ROUNDING) * gamma:
        raise DesignError(f"rounding spoilt the controller at gamma = {gamma:.6g}: its norm is {peak.gain:.6g}")
    controller = robust if behind is None else series(behind, robust)
    controller = controller if before is None else series(controller, before)
    found = ShapedController(
        lti=controller,
        gamma=max(gamma, peak.gain),
        norm=peak.gain,
        omega=peak.omega,
        checks=(
            "every pole of the shaped loop is stable",
            f"its norm for coprime factors is {peak.gain:.6g}, a margin of {1.0 / peak.gain:.4f}",
        ),
        emax=1.0 / factors.least_gamma,
        margin=1.0 / peak.gain,
    )
    return keep_names(found, G)


class NcfMargin(NamedTuple):
    """Margin of a loop for coprime factors."""

    margin: float
    """[-] gap up to which every plant is stabilised too; 0 if the loop is unstable."""
    omega: float
    """[rad/s] frequency at which it is least."""


def ncfmargin(P: LinearSystem, K: LinearSystem | ArrayLike, sign: float = -1.0) -> NcfMargin:
    """Return the margin of a plant and any controller for wrong coprime factors (MATLAB: `ncfmargin`).

    It is `1 / ||[K; I] (I - P K)^-1 [I, P]||` with the sign of the feedback in `K`: -1 for `u = -K y`. A number or
    matrix `K` is a gain.

    Raises
    ------
    ValueError
        If sizes or sample times do not fit, or the loop is not well posed.

    Examples
    --------
    >>> from control import tf
    >>> from gustproof.robust import ncfmargin
    >>> f"{ncfmargin(tf(1, [1, 0]), 1.0).margin:.4f}"
    '0.7071'
    """
    if sign not in (-1, 1):
        raise ValueError(f"sign is {sign!r}, must be -1 or 1")
    plant = as_lti(P)
    C = as_controller(K, plant.dt)
    peak = check_shaped_loop(plant, C if sign > 0.0 else -C)
    return NcfMargin(1.0 / peak.gain if peak.gain > 0.0 else np.inf, peak.omega)


def check_shaped_loop(G: Lti, K: Lti) -> Peak:
    """Return the norm of `[K; I] (I - G K)^-1 [I, G]`, infinite if the loop is unstable.

    Raises
    ------
    ValueError
        If sizes or sample times do not fit, or the loop is not well posed.
    """
    n, m, p = G.order, G.n_inputs, G.n_outputs
    # inputs (w1, w2, u), outputs (u, y, y) with y = w1 + G (w2 + u)
    B = np.hstack([np.zeros((n, p)), G.B, G.B])
    y = np.hstack([np.eye(p), G.D, G.D])
    u = np.hstack([np.zeros((m, p + m)), np.eye(m)])
    C = np.vstack([np.zeros((m, n)), G.C, G.C])
    return hinf_norm(lft(Lti(A=G.A, B=B, C=C, D=np.vstack([u, y, y]), dt=G.dt), K))


def _weight(name: str, weight: LinearSystem | None, plant: Lti, size: int) -> Lti | None:
    if weight is None:
        return None
    W = as_lti(weight)
    if W.D.shape != (size, size):
        raise ValueError(f"{name} is {W.n_outputs} x {W.n_inputs}, must be {size} x {size}")
    if W.dt != plant.dt and not W.order:
        return Lti(A=W.A, B=W.B, C=W.C, D=W.D, dt=plant.dt)
    return W
