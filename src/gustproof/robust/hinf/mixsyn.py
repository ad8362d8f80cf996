"""Mixed sensitivity: weights on S, KS and T, built into a generalised plant and solved."""

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from gustproof.errors import DesignError
from gustproof.robust.hinf.checked_controller import keep_names
from gustproof.robust.hinf.hinfsyn import HinfResult, hinfsyn
from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import LinearSystem, Lti, all_or_none, as_lti, gain, lft, series, signal_names
from gustproof.robust.uncertain.uncertain_system import stack

if TYPE_CHECKING:
    import control

Weight = LinearSystem | ArrayLike | None
"""A stable system or a gain; one of a single channel weights each channel alike; `None`, `[]` leaves the signal out."""


def mixsyn(
    G: LinearSystem, W1: Weight, W2: Weight = None, W3: Weight = None, *, gamma: float | None = None
) -> HinfResult:
    """Return the controller that keeps the norm of (W1 S, W2 K S, W3 T) below a level.

    `S = (I + G K)^-1` and `T = G K S`: the loop has negative feedback, so `u = K (r - G u)`. The checks name the norm
    of each part. Weights left out and poles of G on the imaginary axis make the problem singular. It is then solved
    with small weights and noise, as by `hinfsyn` with `regularize`. The result tells their cost.

    Parameters
    ----------
    G
        Plant, p outputs and m inputs, continuous or discrete.
    W1, W2, W3
        Weights of the error (p channels), the control (m) and the output (p).
    gamma
        [-] level to design for; `None` for 1.05 times the least.

    Raises
    ------
    ValueError
        If no weight is given, or channels or sample times do not fit; the text names the weight.
    DesignError
        If a weight or what `G` hides from K is unstable (the text names it and the pole), or as `hinfsyn`.

    References
    ----------
    S. Skogestad, I. Postlethwaite, Multivariable Feedback Control, 2nd ed., Wiley 2005, section 3.5.7.

    Examples
    --------
    >>> from control import tf
    >>> from gustproof import mixsyn
    >>> G = tf(200, [0.025, 1.0025, 10.1, 1])
    >>> result = mixsyn(G, W1=tf([1 / 1.5, 10], [1, 10 * 1e-4]), W2=1.0)
    >>> f"{result.gamma_opt:.2f}"
    '1.37'
    """
    plant = as_lti(G)
    weights = _weights(plant, W1, W2, W3)
    P = _generalised_plant(plant, weights)
    result = hinfsyn(P, plant.n_outputs, plant.n_inputs, gamma=gamma, regularize=True)
    loop, first = lft(P, result.lti), 0
    checks = list(result.checks)
    for (name, weight), part in zip(weights.items(), ("S", "K S", "T"), strict=True):
        if weight.n_outputs:
            rows = slice(first, first + weight.n_outputs)
            checks.append(f"the norm of {name} {part} is {hinf_norm(loop.subsystem(rows, slice(None))).gain:.6g}")
            first += weight.n_outputs
    named = keep_names(result, G)
    # K reads the error of each output: under the output's own name a diagram would lose the sign
    return replace(named, checks=tuple(checks), measured=tuple(f"e_{name}" for name in named.measured))


def augw(G: LinearSystem, W1: Weight, W2: Weight = None, W3: Weight = None) -> "control.StateSpace":
    """Return the generalised plant of `mixsyn`, from (r, u) to (W1 e, W2 u, W3 g, e), with `g = G u` and `e = r - g`.

    Names of G's signals are kept: of an output "rate" come "r_rate" and "e_rate".

    Raises
    ------
    ValueError
        If no weight is given, or channels or sample times do not fit.
    DesignError
        If a weight is unstable.

    Examples
    --------
    >>> from control import tf
    >>> from gustproof.robust import augw, hinfsyn
    >>> P = augw(tf(200, [0.025, 1.0025, 10.1, 1]), tf([1 / 1.5, 10], [1, 10 * 1e-4]), 1.0)
    >>> hinfsyn(P, n_meas=1, n_con=1, regularize=True).K.input_labels
    ['e[0]']
    """
    plant = as_lti(G)
    P = _generalised_plant(plant, _weights(plant, W1, W2, W3))
    p, m = plant.n_outputs, plant.n_inputs
    controls, measured = map(all_or_none, signal_names(G))
    r, e = ([f"{kind}_{name}" for name in measured] or [f"{kind}[{k}]" for k in range(p)] for kind in "re")
    inputs = [*r, *(controls or (f"control[{k}]" for k in range(m)))]
    return P.to_control(inputs=inputs, outputs=[*(f"z[{k}]" for k in range(P.n_outputs - p)), *e])


def _weights(plant: Lti, W1: Weight, W2: Weight, W3: Weight) -> dict[str, Lti]:
    """Return each weight by name, of the plant's channels."""
    channels = (("W1", W1, plant.n_outputs), ("W2", W2, plant.n_inputs), ("W3", W3, plant.n_outputs))
    weights = {name: _as_weight(name, weight, count, plant) for name, weight, count in channels}
    if not any(weight.n_outputs for weight in weights.values()):
        raise ValueError("one of the weights W1, W2 and W3 must be given")
    return weights


def _as_weight(name: str, weight: Weight, channels: int, G: Lti) -> Lti:
    """Return a weight for a number of channels, with no outputs if there is none."""
    if _is_left_out(weight):
        return gain(np.zeros((0, channels)), G.dt)
    try:
        W = as_lti(weight) if hasattr(weight, "dt") else gain(np.asarray(weight, dtype=np.float64), G.dt)  # type: ignore[arg-type]
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    if W.dt != G.dt:
        raise ValueError(f"{name} has the sample time {W.dt} s, G {G.dt} s")
    if not W.is_stable():
        worst = max(W.poles(), key=abs if G.dt else lambda pole: pole.real)
        raise DesignError(f"{name} is not stable: it has a pole at {worst:.3g}, and no feedback acts on a weight")
    if W.D.shape == (1, 1) and channels > 1:
        W = stack(*[W] * channels).M
    if W.n_inputs != channels:
        raise ValueError(f"{name} has {W.n_inputs} inputs, must have {'' if channels == 1 else '1 or '}{channels}")
    return W


def _is_left_out(weight: Weight) -> bool:
    return weight is None or (not hasattr(weight, "dt") and np.size(weight) == 0)


def _generalised_plant(G: Lti, weights: Mapping[str, Lti]) -> Lti:
    """Return the plant from (r, u) to (W1 e, W2 u, W3 g, e), with `e = r - g` and `g = G u`."""
    p, m, n = G.n_outputs, G.n_inputs, G.order
    zero, identity = np.zeros((m, n)), np.eye(p)
    signals = Lti(
        A=G.A,
        B=np.hstack([np.zeros((n, p)), G.B]),
        C=np.vstack([-G.C, zero, G.C, -G.C]),
        D=np.block([[identity, -G.D], [np.zeros((m, p)), np.eye(m)], [0.0 * identity, G.D], [identity, -G.D]]),
        dt=G.dt,
    )
    return series(signals, stack(*weights.values(), gain(identity, G.dt)).M)
