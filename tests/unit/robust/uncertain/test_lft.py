"""Uncertain systems against the formula that they were written from."""

import control
import numpy as np
import pytest

from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import Lti, gain
from gustproof.robust.uncertain.elements import ultidyn, ureal
from gustproof.robust.uncertain.interconnection import Block, Interconnection, Signal, Sum
from gustproof.robust.uncertain.uncertain_system import (
    Uncertain,
    append,
    as_uncertain,
    fill_diagram,
    lft,
    simplify,
    system_from_matrix,
)

ROUNDING = 1e-12
"""Relative; a handful of products and one small linear system."""

K = ureal("k", range=(1.0, 3.0))
M = ureal("m", range=(0.5, 4.0), nominal=1.0)
INTEGRATOR = Lti(A=np.zeros((1, 1)), B=np.ones((1, 1)), C=np.ones((1, 1)), D=np.zeros((1, 1)))


def spring():
    """m x'' = u - k x, from u to x."""
    matrix = append(1.0, M.inverse(), 1.0) @ np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    force = np.array([[0.0], [1.0], [0.0]]) @ (np.array([[0.0, 0.0, 1.0]]) - K @ np.array([[1.0, 0.0, 0.0]]))
    return system_from_matrix(matrix + append(1.0, M.inverse(), 1.0) @ force, 2)


@pytest.mark.parametrize("delta", [{}, {"k": -1.0, "m": 1.0}, {"k": 0.3}])
def test_a_rational_function_is_written_as_for_numbers(delta):
    value = {"k": 2.0, "m": 1.0} | {
        name: float(block.value(delta[name]))
        for name, block in (("k", K.blocks[0]), ("m", M.blocks[0]))
        if name in delta
    }
    k, m = value["k"], value["m"]
    system = (2.0 * np.eye(1) @ K - M) @ (K + M @ M).inverse() + 3.0
    assert system.member(delta).D[0, 0] == pytest.approx((2.0 * k - m) / (k + m**2) + 3.0, rel=ROUNDING)
    assert (1.0 - K - M).member(delta).D[0, 0] == pytest.approx(1.0 - k - m, rel=ROUNDING)


def test_parameters_of_one_name_are_one_parameter():
    assert [(block.name, block.repeats) for block in (K @ M + K).blocks] == [("m", 1), ("k", 1)]
    with pytest.raises(ValueError, match="'k' has two meanings: k: real, 2 in"):
        _ = K + ureal("k", range=(1.0, 2.0))
    with pytest.raises(ValueError, match="block 'F' occurs twice"):
        _ = ultidyn("F", 2, 2) + ultidyn("F", 2, 2)
    with pytest.raises(ValueError, match="M is 1 x 1, Delta alone needs 2 x 2"):
        Uncertain(M=gain([[1.0]]), blocks=(*K.blocks, *M.blocks))


def test_a_spring_mass_system_resonates_where_it_should():
    for m, k in ((0.5, 3.0), (4.0, 1.0)):
        system = spring()
        poles = system.member(system.delta({"m": m, "k": k})).poles()
        assert np.max(np.abs(poles.real)) < ROUNDING
        assert np.max(poles.imag) == pytest.approx(np.sqrt(k / m), rel=ROUNDING)


def test_many_values_at_once_are_the_single_ones():
    system = append(K, M) @ np.ones((2, 2)) @ append(M, K).inverse()
    delta = {"k": np.linspace(-1.0, 1.0, 7), "m": np.linspace(0.9, -0.9, 7)}
    together = system.matrices(delta)
    for k in range(7):
        assert together[k] == pytest.approx(system.member({name: delta[name][k] for name in delta}).D, rel=ROUNDING)
    with pytest.raises(ValueError, match="only a matrix"):
        spring().matrices({})
    with pytest.raises(ValueError, match="unknown parameter 'x'"):
        system.matrices({"x": 0.0})
    with pytest.raises(ValueError, match="unknown parameter 'x', there are m, k"):
        system.delta({"x": 0.0})


def test_a_loop_around_an_uncertain_plant_is_the_loop_around_each_member():
    plant = np.ones((2, 1)) @ spring() @ np.ones((1, 2))
    controller = Lti(A=[[-3.0]], B=[[1.0]], C=[[-2.0]], D=[[-0.1]])
    delta = {"k": 0.7, "m": -0.2}
    member = control.ss(spring().member(delta).to_control())
    loop = control.feedback(member, -controller.to_control(), sign=1)
    expected = control.feedback(member, controller.to_control(), sign=1)
    response = lft(plant, controller).member(delta).response(0.8)[0, 0, 0]
    assert response == pytest.approx(expected(0.8j), rel=1e-9)  # python-control's own rounding
    assert response != pytest.approx(loop(0.8j), rel=1e-3)


def test_a_star_product_with_neglected_dynamics_closes_them_where_they_stand():
    # multiplicative uncertainty: y = (1 + 0.3 Delta) u
    outer = gain([[1.0, 0.3], [1.0, 0.0]])
    system = lft(outer, ultidyn("F"), 1, 1)
    assert system.member({"F": 0.5}).D[0, 0] == pytest.approx(1.15)
    with pytest.raises(ValueError, match="no 3 signals down"):
        lft(outer, ultidyn("F"), 3, 1)


def test_no_inverse_where_there_is_none():
    with pytest.raises(ValueError, match="only a square one"):
        as_uncertain([[1.0, 2.0]]).inverse()
    with pytest.raises(ValueError, match="the nominal feedthrough of the system of 'z' is singular"):
        1.0 / ureal("z", range=(-1.0, 1.0))
    with pytest.raises(ValueError, match=r"singular for some 'z' in \[-1, 2\]"):
        1.0 / ureal("z", range=(-1.0, 2.0))


def test_different_sample_times_are_refused_and_matrices_have_none():
    sampled = Lti(A=[[0.5]], B=[[1.0]], C=[[1.0]], D=[[0.0]], dt=0.1)
    with pytest.raises(ValueError, match="sample times differ"):
        append(sampled, INTEGRATOR)
    assert (K @ sampled).member({}).dt == 0.1
    with pytest.raises(ValueError, match="states or a sample time of its own"):
        system_from_matrix(as_uncertain(sampled), 1)


def test_uncertain_blocks_of_a_diagram_are_joined_by_its_labels():
    diagram = Interconnection(
        signals=tuple(Signal(name=name, label="", width=1) for name in ("w", "u", "e", "x", "v")),
        blocks=(
            Block(name="plant", label="", system=INTEGRATOR, inputs=("e",), outputs=("x",)),
            Block(name="sensor", label="", system=gain([[1.0]]), inputs=("x",), outputs=("v",)),
        ),
        sums=(Sum(output="e", terms=((1, "w"), (-1, "v"), (1, "u"))),),
        w=("w",),
        u=("u",),
        z=("e",),
        y=("v",),
    )
    system = fill_diagram(diagram, {"plant": spring(), "sensor": K})
    delta = {"k": -0.4, "m": 0.8}
    k, m = float(K.blocks[0].value(-0.4)), float(M.blocks[0].value(0.8))
    G = 1.0 / (-m * 0.49 + k)
    expected = 1.0 / (1.0 + k * G)
    response = system.member(delta).response(0.7)[0]
    assert response[0, 0] == pytest.approx(expected, rel=ROUNDING)
    assert response[1, 1] == pytest.approx(k * G * expected, rel=ROUNDING)
    with pytest.raises(ValueError, match="no block 'motor'"):
        fill_diagram(diagram, {"motor": K})


def test_a_sampled_family_is_for_python_control_and_repeats_with_its_seed():
    system = spring()
    family, again = ([system.substitute(values) for values in system.sample(5, 3)] for _ in range(2))
    assert all(isinstance(member, control.StateSpace) for member in family)
    assert all(np.array_equal(a.A, b.A) for a, b in zip(family, again, strict=True))
    stiffness = [-member.A[1, 0] for member in family]
    assert min(stiffness) >= 1.0 / 4.0
    assert max(stiffness) <= 3.0 / 0.5
    assert len(set(stiffness)) == 5
    family = [ultidyn("F", 2, 3, bound=0.5).substitute(values) for values in ultidyn("F", 2, 3, bound=0.5).sample(9, 0)]
    assert 0.3 < max(hinf_norm(member).gain for member in family) <= 0.5
    assert [values["k"] for values in K.grid(3)] == [1.0, 2.0, 3.0]


def test_reduction_finds_the_least_order_of_one_parameter():
    t = ureal("t", range=(-0.5, 0.7))
    c = (1.0 - t @ t) @ (1.0 + t @ t).inverse()
    s = 2.0 * np.eye(1) @ t @ (1.0 + t @ t).inverse()
    turn = np.array([[1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0]]) @ append(c, -s, s, c) @ np.tile(np.eye(2), (2, 1))
    small = simplify(turn)
    assert (append(c, -s, s, c).n_w, small.n_w) == (8, 2)
    delta = {"t": np.linspace(-1.0, 1.0, 20)}
    assert np.allclose(small.matrices(delta), turn.matrices(delta), atol=ROUNDING)


def test_reduction_removes_states_and_parameters_that_do_nothing():
    system = append(spring(), INTEGRATOR @ ureal("x", range=(0.0, 1.0))) @ np.array([[1.0], [0.0]])
    small = simplify(np.array([[1.0, 1.0]]) @ (system + append(ultidyn("F"), 0.0) @ np.ones((2, 1))))
    assert small.M.order == 2
    assert "x" not in [block.name for block in small.blocks]
    delta = {"k": 0.2, "m": -0.5, "F": 0.3}
    assert small.member(delta).response(0.3)[0, 0, 0] == pytest.approx(
        spring().member({"k": 0.2, "m": -0.5}).response(0.3)[0, 0, 0] + 0.3
    )


def test_a_controller_larger_than_its_plant_is_refused():
    with pytest.raises(ValueError, match="P, 1 x 2, and K, 1 x 3, have no"):
        lft(ureal("k", range=(0.5, 1.5)) @ np.ones((1, 2)), np.ones((1, 3)))


def test_a_complex_value_is_refused_by_name():
    with pytest.raises(ValueError, match="the normalised value of 'part' is complex"):
        ultidyn("part").member({"part": 0.5j})
