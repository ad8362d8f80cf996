"""Distances between plants as seen from feedback: the gap and Vinnicombe's nu-gap."""

from typing import NamedTuple

import numpy as np
import scipy

from gustproof.robust.coprime.factors import CoprimeFactors, coprime_factors
from gustproof.robust.hinf.hinfsyn import hinfsyn
from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import LinearSystem, Lti, Matrix, as_lti, series

_SINGULAR = 1e-12
"""[-] smallest singular value of an isometry's product at infinity below which the plants are 1 apart there."""
_AXIS = 1e-10
"""[-] real parts of zeros below this fraction of the largest count as on the axis, where the distance is 1."""
_NEARLY_EQUAL = 1e-6
"""[-] distances below which both metrics are the same to rounding, as they are for gains: no synthesis follows."""


class Gap(NamedTuple):
    """Two distances of two plants, 0 for the same plant and 1 at most (MATLAB: `[gap, nugap]`).

    Examples
    --------
    >>> from control import ss, tf
    >>> from gustproof import gapmetric
    >>> gap, nugap = gapmetric(ss(tf(1, [1, 0])), ss(tf(1, [1, 0])))
    >>> round(gap, 6), round(nugap, 6)
    (0.0, 0.0)
    """

    gap: float
    """[-] gap of Zames and El-Sakkary, from above to 1e-6."""
    nugap: float
    """[-] nu-gap of Vinnicombe, at most `gap`."""


def gapmetric(G1: LinearSystem, G2: LinearSystem) -> Gap:
    """Return the gap and the nu-gap between two plants of equal sizes, continuous or discrete (MATLAB: `gapmetric`).

    A controller with the margin b for `G1` stabilises every plant closer than b in either metric: see `ncfsyn`. The
    nu-gap is an H-infinity norm if a winding number is 0, and 1 otherwise. Zeros of a state-space system count it, so
    no frequency is gridded. The gap is the least level of two H-infinity problems.

    Raises
    ------
    ValueError
        If sizes or sample times differ.
    DesignError
        If a plant has no coprime factors.

    References
    ----------
    G. Vinnicombe, Uncertainty and Feedback, Imperial College Press 2001, Definition 3.1. T. T. Georgiou, On the
    computation of the gap metric, Systems & Control Letters 11 (1988), 253-257.

    Examples
    --------
    >>> from control import ss, tf
    >>> from gustproof import gapmetric
    >>> gap, nugap = gapmetric(ss(tf(1, [1, -0.001])), ss(tf(1, [1, 0.001])))
    >>> f"{gap:.4f} {nugap:.4f}"
    '0.0020 0.0020'
    """
    first, second = as_lti(G1), as_lti(G2)
    if first.D.shape != second.D.shape:
        shapes = [f"{G.n_outputs} x {G.n_inputs}" for G in (first, second)]
        raise ValueError(f"the plants are {shapes[0]} and {shapes[1]}, must be of one size")
    if first.dt != second.dt:
        raise ValueError(f"sample times differ: {first.dt} s and {second.dt} s")
    left, right = coprime_factors(first), coprime_factors(second)
    if not _winds_zero_times(left, right):
        return Gap(1.0, 1.0)
    nugap = min(1.0, hinf_norm(series(left.graph(), right.inverse_graph())).gain)
    if nugap < _NEARLY_EQUAL or not first.order + second.order:
        return Gap(nugap, nugap)
    directed = max(_directed_gap(left, right), _directed_gap(right, left))
    return Gap(min(1.0, max(nugap, directed)), nugap)


def _winds_zero_times(first: CoprimeFactors, second: CoprimeFactors) -> bool:
    """Return True if `det(graph2~ graph1)` has no zero on the axis and winds 0 times about 0.

    Its poles outside are those of `graph2~`, one for each state. So it needs as many zeros outside.
    """
    one, two = first.graph(), second.graph()
    adjoint = Lti(A=-two.A.T, B=-two.C.T, C=two.B.T, D=two.D.T)
    product = series(one, adjoint)
    if np.linalg.svd(product.D, compute_uv=False)[-1] < _SINGULAR:
        return False
    if not product.order:
        return True
    inverse = product.A - product.B @ np.linalg.solve(product.D, product.C)
    zeros = Lti(A=inverse, B=product.B, C=product.C, D=product.D).poles()
    on_axis = np.abs(zeros.real).min() <= _AXIS * np.abs(zeros).max()
    return not on_axis and int(np.sum(zeros.real > 0.0)) == two.order


def _directed_gap(first: CoprimeFactors, second: CoprimeFactors) -> float:
    """Return the least norm of `graph1 - graph2 Q` over stable Q, from above: Q is the controller of a plant."""
    one, two = first.graph(), second.graph()
    n, m = one.order, one.n_inputs
    A: Matrix = scipy.linalg.block_diag(one.A, two.A)
    B: Matrix = scipy.linalg.block_diag(one.B, two.B)
    C = np.vstack([np.hstack([one.C, two.C]), np.zeros((m, n + two.order))])
    D = np.block([[one.D, two.D], [np.eye(m), np.zeros((m, m))]])
    return hinfsyn(Lti(A=A, B=B, C=C, D=D), m, m).gamma_opt
