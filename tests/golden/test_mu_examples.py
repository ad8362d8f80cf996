"""Values of mu that others have published."""

import json
from pathlib import Path

import numpy as np
import pytest

from gustproof.robust.hinf.hinfsyn import hinfsyn
from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import Lti, Matrix, lft
from gustproof.robust.mu.minimum_phase import MinimumPhase
from gustproof.robust.mu.scaled_plant import dynamic_filters, transform
from gustproof.robust.mu.scalings import best_scalings
from gustproof.robust.mu.singular_value import mu
from gustproof.robust.uncertain.interconnection import Block, Interconnection, Signal, Sum
from gustproof.robust.uncertain.uncertain_system import Uncertain
from gustproof.robust.uncertain.uncertainty import FullBlock

EXAMPLES = json.loads((Path(__file__).parent / "mu.json").read_text(encoding="utf-8"))
EXAMPLE = EXAMPLES["distillation"]
PRINTED = 0.005
"""Half of the last digit printed."""
INTEGRATOR = 1e-6
"""[rad/s] pole that stands for an integrator, far below every corner."""


def first_order(gain: Matrix, pole: float, direct: Matrix) -> Lti:
    """gain / (s + pole) + direct; its size is divided between input and output."""
    root = np.sqrt(np.linalg.norm(gain, 2))
    return Lti(A=-pole * np.eye(2), B=gain / root, C=root * np.eye(2), D=direct)


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


def weighted_plant(G: Lti, w_I: Lti, w_P: Lti, sign: int) -> Lti:
    """P from (output of Delta, disturbance at the output, u) to (w_I u, w_P e, y); y is `sign` times the error e."""
    diagram = Interconnection(
        signals=tuple(Signal(name=name, label="", width=2) for name in ("w", "d", "u", "z", "p", "g", "e", "z_p", "y")),
        blocks=(
            Block(name="G", label="", system=G, inputs=("p",), outputs=("g",)),
            Block(name="w_I", label="", system=w_I, inputs=("u",), outputs=("z",)),
            Block(name="w_P", label="", system=w_P, inputs=("e",), outputs=("z_p",)),
        ),
        sums=(
            Sum(output="p", terms=((1, "u"), (1, "w"))),
            Sum(output="e", terms=((1, "g"), (1, "d"))),
            Sum(output="y", terms=((sign, "e"),)),
        ),
        w=("w", "d"), u=("u",), z=("z", "z_p"), y=("y",),
    )  # fmt: skip
    return diagram.system(("w", "d", "u"), ("z", "z_p", "y"))


def distillation_plant() -> Lti:
    one = np.eye(2)
    G = first_order(np.array(EXAMPLE["gain"]) / EXAMPLE["lag_s"], 1.0 / EXAMPLE["lag_s"], 0.0 * one)
    w_P = first_order((0.05 - 0.5 * INTEGRATOR) * one, INTEGRATOR, 0.5 * one)
    return weighted_plant(G, first_order(-3.6 * one, 2.0, 2.0 * one), w_P, -1)


def test_distillations_first_controller_has_the_peak_that_the_book_prints():
    first = EXAMPLES["distillation_synthesis"]["first"]
    result = hinfsyn(distillation_plant(), 2, 2, gamma=first["norm"])
    assert result.order == first["order"]
    found = mu(Uncertain(M=lft(distillation_plant(), result.lti), blocks=CHANNELS), accuracy=0.004)
    # the printed peak is that of a frequency grid
    assert found.lower == pytest.approx(first["mu"], abs=5e-4)
    assert found.upper <= 1.005 * found.lower


def himat_plant() -> Lti:
    data, one = EXAMPLES["himat"], np.eye(2)
    G = Lti(A=np.array(data["A"]), B=np.array(data["B"]), C=np.array(data["C"]), D=np.zeros((2, 2)))
    # w_I = 50 (s + 100) / (s + 10000), w_P = (s / 2 + 1.5) / (s + .03)
    w_I = first_order((5000.0 - 50.0 * 10000.0) * one, 10000.0, 50.0 * one)
    return weighted_plant(G, w_I, first_order((1.5 - 0.5 * 0.03) * one, 0.03, 0.5 * one), 1)


@pytest.mark.parametrize(
    ("name", "plant", "sizes", "published"),
    [
        (
            "distillation_synthesis",
            distillation_plant,
            [(1, 1), (1, 1)],
            EXAMPLES["distillation_synthesis"]["last"],
        ),
        ("himat", himat_plant, [(2, 2)], 1.0),
    ],
)
def test_the_filters_that_musyn_found_give_the_published_mu(name, plant, sizes, published):
    """The filters are from a run of musyn; the level that they prove is computed here, from the loop."""
    data, P = EXAMPLES[name], plant()
    found = [MinimumPhase(order=one["order"], theta=np.array(one["theta"])) for one in data["filters"]]
    one = MinimumPhase(order=0, theta=np.zeros(1))
    filters = dynamic_filters([*((d, d) for d in found), (one, one)], [*sizes, (2, 2)])
    scaled = transform(P, filters, 4, 4)
    level = hinfsyn(scaled, 2, 2).gamma_opt
    assert level == pytest.approx(data["level"], abs=2e-5)
    assert level < published
    result = hinfsyn(scaled, 2, 2, gamma=1.002 * level)
    loop = lft(P, result.lti)
    assert loop.is_stable()
    # mu at each frequency is at most the norm with the filters' scalings, whatever the bounds of the sweep
    at = float(result.omega) if np.isfinite(result.omega) else 1.0
    blocks = tuple(FullBlock(name=str(k), n_outputs=n_w, n_inputs=n_z) for k, (n_w, n_z) in enumerate([*sizes, (2, 2)]))
    for omega in (0.1 * at, at, 10.0 * at):
        response = loop.response(omega)[0]
        assert best_scalings(response, blocks, gain=False).level(response) <= result.norm * 1.002
