"""Least levels that others have published."""

import json
from pathlib import Path

import control
import pytest

from gustproof.robust.hinf.hinfsyn import hinfsyn
from gustproof.robust.lti.state_space import Lti, gain
from gustproof.robust.uncertain.interconnection import Block, Interconnection, Signal, Sum

GOLDEN = json.loads((Path(__file__).parent / "hinfsyn.json").read_text(encoding="utf-8"))
PRINTED = 0.005
"""Half of the last digit printed."""


def test_slicots_example_with_full_d_matrices():
    example = GOLDEN["sb10ad"]
    P = Lti(**{name: example[name] for name in "ABCD"})
    result = hinfsyn(P, example["n_meas"], example["n_con"])
    assert result.gamma_opt == pytest.approx(example["gamma_opt"], abs=PRINTED)
    assert result.norm < result.gamma


def test_skogestads_mixed_sensitivity_example():
    example = GOLDEN["skogestad"]
    weight = example["performance_weight"]
    G = control.ss(control.zpk([], example["plant"]["poles_rad_s"], example["plant"]["zpk_gain"]))
    W_p = control.tf2ss([1.0 / weight["M"], weight["bandwidth_rad_s"]], [1.0, weight["bandwidth_rad_s"] * weight["A"]])
    signals = tuple(Signal(name=name, label="", width=1) for name in ("r", "u", "g", "e", "z_p", "z_u"))
    problem = Interconnection(
        signals=signals,
        blocks=(
            Block(name="G", label="$G$", system=G, inputs=("u",), outputs=("g",)),
            Block(name="W_p", label="$W_P$", system=W_p, inputs=("e",), outputs=("z_p",)),
            Block(name="W_u", label="$W_u$", system=gain([[1.0]]), inputs=("u",), outputs=("z_u",)),
        ),
        sums=(Sum(output="e", terms=((1, "r"), (-1, "g"))),),
        w=("r",),
        u=("u",),
        z=("z_p", "z_u"),
        y=("e",),
    )
    result = hinfsyn(problem.plant(), problem.n_meas, problem.n_con)
    assert result.gamma_opt == pytest.approx(example["gamma_opt"], abs=PRINTED)
    assert result.norm < result.gamma


def test_slicots_discrete_example_has_a_controller_a_little_above_its_least_level():
    # SB10DD, gamma = 111.294: its own controller has 111.29389; the least level is 111.29320
    A = [
        [-0.7, 0.0, 0.3, 0.0, -0.5, -0.1],
        [-0.6, 0.2, -0.4, -0.3, 0.0, 0.0],
        [-0.5, 0.7, -0.1, 0.0, 0.0, -0.8],
        [-0.7, 0.0, 0.0, -0.5, -1.0, 0.0],
        [0.0, 0.3, 0.6, -0.9, 0.1, -0.4],
        [0.5, -0.8, 0.0, 0.0, 0.2, -0.9],
    ]
    B = [
        [-1.0, -2.0, -2.0, 1.0, 0.0],
        [1.0, 0.0, 1.0, -2.0, 1.0],
        [-3.0, -4.0, 0.0, 2.0, -2.0],
        [1.0, -2.0, 1.0, 0.0, -1.0],
        [0.0, 1.0, -2.0, 0.0, 3.0],
        [1.0, 0.0, 3.0, -1.0, -2.0],
    ]
    C = [
        [1.0, -1.0, 2.0, -2.0, 0.0, -3.0],
        [-3.0, 0.0, 1.0, -1.0, 1.0, 0.0],
        [0.0, 2.0, 0.0, -4.0, 0.0, -2.0],
        [1.0, -3.0, 0.0, 0.0, 3.0, 1.0],
        [0.0, 1.0, -2.0, 1.0, 0.0, -2.0],
    ]
    D = [
        [1.0, -1.0, -2.0, 0.0, 0.0],
        [0.0, 1.0, 0.0, 1.0, 0.0],
        [2.0, -1.0, -3.0, 0.0, 1.0],
        [0.0, 1.0, 0.0, 1.0, -1.0],
        [0.0, 0.0, 1.0, 2.0, 1.0],
    ]
    result = hinfsyn(Lti(A=A, B=B, C=C, D=D, dt=1.0), 2, 2, gamma=111.294)
    assert result.norm + result.norm_error < 111.294
