"""Values of mu that others have published."""

import json
from pathlib import Path

import numpy as np
import pytest

from gustproof.certify.mu.singular_value import mu
from gustproof.lti.norms import hinf_norm
from gustproof.lti.state_space import Lti, Matrix
from gustproof.model.interconnection import Block, Interconnection, Signal, Sum
from gustproof.model.lft import Uncertain
from gustproof.model.uncertainty import FullBlock

EXAMPLE = json.loads((Path(__file__).parent / "mu.json").read_text(encoding="utf-8"))["distillation"]
PRINTED = 0.005
"""Half of the last digit printed."""
INTEGRATOR = 1e-6
"""[rad/s] pole that stands for an integrator, far below every corner."""


def first_order(gain: Matrix, pole: float, direct: Matrix) -> Lti:
    """gain / (s + pole) + direct."""
    return Lti(A=-pole * np.eye(2), B=gain, C=np.eye(2), D=direct)


def distillation() -> Lti:
    """M from (output of Delta, reference) to (input of Delta, weighted error): w_I u and w_P e."""
    G0, lag, k = np.array(EXAMPLE["gain"]), EXAMPLE["lag_s"], EXAMPLE["loop_gain"]
    inverse, one = np.linalg.inv(G0), np.eye(2)
    G = first_order(G0 / lag, 1.0 / lag, 0.0 * one)
    # K = k (75 s + 1) / s inverse(G0), w_I = (s + .2) / (.5 s + 1), w_P = (s / 2 + .05) / s
    K = first_order(k * inverse, INTEGRATOR, k * lag * inverse)
    w_I = first_order(-3.6 * one, 2.0, 2.0 * one)
    w_P = first_order(0.05 * one, INTEGRATOR, 0.5 * one)
    diagram = Interconnection(
        signals=tuple(Signal(name=name, label="", width=2) for name in ("w", "r", "u", "z", "p", "y", "e", "z_p")),
        blocks=(
            Block(name="G", label="", system=G, inputs=("p",), outputs=("y",)),
            Block(name="K", label="", system=K, inputs=("e",), outputs=("u",)),
            Block(name="w_I", label="", system=w_I, inputs=("u",), outputs=("z",)),
            Block(name="w_P", label="", system=w_P, inputs=("e",), outputs=("z_p",)),
        ),
        sums=(Sum(output="p", terms=((1, "u"), (1, "w"))), Sum(output="e", terms=((1, "r"), (-1, "y")))),
        w=("w", "r"), u=(), z=("z", "z_p"), y=(),
    )  # fmt: skip
    return diagram.system(("w", "r"), ("z", "z_p"))


CHANNELS = (FullBlock(name="first"), FullBlock(name="second"))


def test_distillation_with_an_inverse_has_no_robust_performance():
    M = distillation()
    found = mu(Uncertain(M=M, blocks=CHANNELS), accuracy=0.004)
    assert found.upper <= 1.005 * found.lower
    # the printed peak is that of a frequency grid, so it may lie below the supremum by a little
    assert EXAMPLE["robust_performance"] - PRINTED <= found.lower <= 1.003 * EXAMPLE["robust_performance"]
    Delta = np.zeros((4, 4), dtype=complex)
    Delta[0, 0], Delta[1, 1] = (np.asarray(found.delta[name]).item() for name in ("first", "second"))
    Delta[2:, 2:] = found.delta["performance"]
    response = M.response(found.omega)[0]
    assert np.linalg.norm(Delta, 2) == pytest.approx(1.0 / found.lower, rel=2e-3)
    assert abs(np.linalg.det(np.eye(4) - response @ Delta)) < 1e-9


def test_distillation_with_an_inverse_is_robustly_stable_and_nominally_good():
    M = distillation()
    stability = mu(Uncertain(M=M.subsystem(slice(0, 2), slice(0, 2)), blocks=CHANNELS), accuracy=0.004)
    assert stability.lower == pytest.approx(EXAMPLE["robust_stability"], abs=PRINTED)
    assert stability.upper == pytest.approx(EXAMPLE["robust_stability"], abs=PRINTED)
    assert hinf_norm(M.subsystem(slice(2, 4), slice(2, 4))).gain == pytest.approx(
        EXAMPLE["nominal_performance"], abs=PRINTED
    )
