"""A labelled diagram against the same loop written by hand, and diagrams that make no sense."""

import dataclasses

import control
import numpy as np
import pytest

from gustproof.robust.lti.state_space import Lti, gain
from gustproof.robust.uncertain.interconnection import Block, Interconnection, Signal, Sum

G = Lti(A=[[-1.0]], B=[[1.0]], C=[[1.0]], D=[[0.5]])


def signals(*names: str) -> tuple[Signal, ...]:
    return tuple(Signal(name=name, label=f"${name}$", width=1) for name in names)


LOOP = Interconnection(
    signals=signals("r", "u", "g", "e"),
    blocks=(Block(name="G", label="$G$", system=G, inputs=("u",), outputs=("g",)),),
    sums=(Sum(output="e", terms=((1, "r"), (-1, "g"))),),
    w=("r",),
    u=("u",),
    z=("e",),
    y=("e",),
)


def test_the_plant_of_an_error_loop_is_the_one_written_by_hand():
    P = LOOP.plant()
    assert np.array_equal(P.D, [[1.0, -0.5], [1.0, -0.5]])
    assert np.array_equal(P.B, [[0.0, 1.0]])
    assert np.array_equal(P.C, [[-1.0], [-1.0]])


def test_a_block_may_come_from_python_control():
    theirs = dataclasses.replace(LOOP.blocks[0], system=control.ss([[-1.0]], [[1.0]], [[1.0]], [[0.5]]))
    assert np.array_equal(dataclasses.replace(LOOP, blocks=(theirs,)).plant().A, G.A)


def test_a_discrete_block_is_refused():
    theirs = dataclasses.replace(LOOP.blocks[0], system=control.ss([[0.5]], [[1.0]], [[1.0]], [[0.5]], 0.004))
    with pytest.raises(ValueError, match=r"block 'G' is discrete, dt = 0\.004 s, must be continuous"):
        dataclasses.replace(LOOP, blocks=(theirs,))


def test_a_loop_of_blocks_is_closed_feedthrough_and_all():
    closed = Interconnection(
        signals=signals("r", "g", "e", "x"),
        blocks=(
            Block(name="G", label="", system=G, inputs=("e",), outputs=("g",)),
            Block(name="k", label="", system=gain([[2.0]]), inputs=("g",), outputs=("x",)),
        ),
        sums=(Sum(output="e", terms=((1, "r"), (-1, "x"))),),
        w=("r",),
        u=(),
        z=("g",),
        y=(),
    )
    response = closed.system(("r",), ("g",)).response(3.0)[0, 0, 0]
    open_loop = G.response(3.0)[0, 0, 0]
    assert response == pytest.approx(open_loop / (1.0 + 2.0 * open_loop), rel=1e-12)


def test_a_loop_without_lag_and_without_solution_is_refused():
    singular = Interconnection(
        signals=signals("r", "g", "e"),
        blocks=(Block(name="k", label="", system=gain([[1.0]]), inputs=("e",), outputs=("g",)),),
        sums=(Sum(output="e", terms=((1, "r"), (1, "g"))),),
        w=("r",),
        u=(),
        z=("g",),
        y=(),
    )
    with pytest.raises(ValueError, match="without lag"):
        singular.system(("r",), ("g",))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"w": ()}, "'r' is made 0 times"),
        ({"u": ("u", "g")}, "'g' is made 2 times"),
        ({"z": ("q",)}, "unknown signal 'q'"),
        ({"blocks": (Block(name="G", label="", system=gain(np.eye(2)), inputs=("u",), outputs=("g",)),)}, "2 x 2"),
        (
            {"signals": (*signals("u", "g", "e"), Signal(name="r", label="", width=2))},
            "adds signals of different widths",
        ),
    ],
)
def test_a_diagram_that_makes_no_sense_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(LOOP, **change)


def test_an_input_must_come_from_outside():
    with pytest.raises(ValueError, match="'g' is made inside"):
        LOOP.system(("g",), ("e",))
