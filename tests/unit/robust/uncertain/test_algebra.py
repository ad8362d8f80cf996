"""The algebra as users write it, against members substituted one by one; and what it must refuse."""

import control as ct
import numpy as np
import pytest
import scipy

from gustproof.robust import append, connect, feedback, hinf_norm, lft, simplify, ucomplex, ultidyn, ureal, uss
from gustproof.robust.lti.state_space import as_lti
from gustproof.robust.uncertain.uncertain_system import Uncertain

SAME = 1e-10
POINT = 0.3 + 0.7j
M, K = ureal("m", 2.0, percent=20), ureal("k", range=(1.0, 4.0), nominal=3.0)
G = ct.tf([1.0, 2.0], [1.0, 3.0, 1.0])
H = ct.ss([[-1.0, 0.2], [0.0, -2.0]], np.eye(2), np.eye(2), 0.3 * np.eye(2))
ROW, TURN = np.array([[1.0, 2.0]]), np.array([[1.0, 2.0], [3.0, -4.0]])


def at(system: object) -> np.ndarray:
    """The value of a known system at one point of the plane."""
    return as_lti(system).transfer(np.array([POINT]))[0]


@pytest.mark.parametrize("values", [{}, {"m": 2.3, "k": 1.2}, {"m": 1.6, "k": 4.0}])
@pytest.mark.parametrize(
    "write",
    [
        lambda m, k, g, h: 0.4 * m + k / 2 - 1,
        lambda m, k, g, h: 1 / m - 3 / (k * m),
        lambda m, k, g, h: (m - k) / (k + m**2) ** 2 + m**0 * m**-3,
        lambda m, k, g, h: g * (1 / m) + g - m,
        lambda m, k, g, h: m * g * k + g * m * 2.0,
        lambda m, k, g, h: (h / m - k * h) @ TURN + 1.5,
        lambda m, k, g, h: TURN @ (m * h) * k - h,
        lambda m, k, g, h: np.float64(2.0) * (1 - k) * ROW @ h + g,
        lambda m, k, g, h: m * g / (1 + m * g * k),
    ],
)
def test_systems_numbers_and_arrays_are_written_as_numbers_are(write, values):
    m, k = values.get("m", 2.0), values.get("k", 3.0)
    expected = np.atleast_2d(write(m, k, at(G).item(), at(H)))
    found = write(M, K, G, H)
    assert isinstance(found, Uncertain)
    values = {block.name: values[block.name] for block in found.blocks if values}
    assert at(found.substitute(values)) == pytest.approx(expected, rel=SAME, abs=SAME)


def test_a_state_space_takes_an_uncertain_divisor_and_a_loop_is_the_formula():
    plant = ct.ss(G) / M * K
    for values in plant.sample(3, seed=1):
        g = at(G).item() * values["k"] / values["m"]
        for loop, expected in (
            (feedback(plant, 0.5), g / (1 + 0.5 * g)),
            (feedback(plant, ct.ss(G), sign=1), g / (1 - g * at(G).item())),
            (ct.feedback(plant, 1), g / (1 + g)),  # python-control hands it on
            (ct.series(ct.ss(G), plant, ct.ss(G)), g * at(G).item() ** 2),
            (ct.parallel(ct.ss(G), plant), g + at(G).item()),
            (ct.append(plant, ct.ss(G))[0, 0], g),
            (ct.negate(plant), -g),
            (feedback(2.0, plant), 2.0 / (1 + 2.0 * g)),
            (lft(TURN * 0.1, plant), 0.1 + 0.2 * g / (1 + 0.4 * g) * 0.3),
            (lft(plant, TURN * 0.1), -0.4 + 0.3 * g / (1 - 0.1 * g) * 0.2),
        ):
            assert at(loop.substitute(values)) == pytest.approx(expected, rel=SAME)
            assert {block.name: block.repeats for block in loop.blocks} == {"m": 1, "k": 1}
    with pytest.raises(TypeError):
        ct.feedback(ct.ss(G), plant)


def test_known_systems_alone_give_a_state_space_with_its_names():
    plant, gain = ct.ss(-1, 1, 1, 0, inputs="u", outputs="y"), ct.ss([], [], [], 4, inputs="e", outputs="u")
    loop = connect(plant, gain, ct.summing_junction(["r", "-y"], "e"), inputs=["r"], outputs=["y"])
    found = (append(plant, 2), feedback(plant, 4), lft(H, -TURN), loop)
    assert all(isinstance(each, ct.StateSpace) for each in found)
    assert (found[1].input_labels, found[1].poles()) == (["u"], pytest.approx(-5.0))
    assert (loop.input_labels, loop.output_labels, loop.poles()) == (["r"], ["y"], pytest.approx(-5.0))
    assert (append(1, 2) * ct.ss(0.5, 1, 1, 0, 0.1)).dt == 0.1  # a gain has no time of its own
    one = connect(plant, gain, ct.summing_junction(["r", "-y"], "e"), inputs="r", outputs="y")
    assert (one.input_labels, simplify(one).M.order) == (["r"], 1)
    assert (M * plant).with_names(outputs="level").outputs == ("level",)
    assert isinstance(feedback(Uncertain(M=as_lti(plant))), Uncertain)


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_matrices_have_uncertain_entries(dt):
    A = [[0, 1], [-K / M, -0.2 * K * M]]
    plant = uss(A, [[0], [1 / M]], [[1, 0], [K, M]], np.array([[0.0], [0.3]]), dt)
    spring = uss([[0, 1], [-K / M, -3 / M]], [[0], [1 / M]], [[1, 0]], [[0]])
    assert {block.name: block.repeats for block in spring.blocks} == {"m": 1, "k": 1}
    for values in plant.sample(3, seed=3):
        member, m, k = plant.substitute(values), values["m"], values["k"]
        assert member.dt == dt
        for found, expected in (
            (member.A, [[0, 1], [-k / m, -0.2 * k * m]]),
            (member.B, [[0], [1 / m]]),
            (member.C, [[1, 0], [k, m]]),
            (member.D, [[0], [0.3]]),
            (spring.substitute(values).A, [[0, 1], [-k / m, -3 / m]]),
        ):
            assert found == pytest.approx(np.array(expected), rel=SAME, abs=SAME)


def test_copies_go_where_they_change_nothing_and_states_stay():
    occurrences = {block.name: block.repeats for block in (M * K + M - 2 * M * (K + 1) + 1 / M / M).blocks}
    assert occurrences == {"m": 3, "k": 1}  # of order two in 1/m beside m
    assert ([[1, 2]] * append(M, M)).blocks[0].repeats == 1
    assert append(M, K, M)[:2, :2].blocks[0].repeats == 1
    hidden = ureal("a", range=(1, 2)) * (ct.tf([1, -1], [1, 2]) * ct.tf(1, [1, 0]))
    unseen = append(hidden, hidden)[0, 0]
    assert (unseen.M.order, unseen.blocks[0].repeats) == (4, 1)
    assert (simplify(unseen).M.order, simplify(unseen).blocks[0].repeats) == (2, 1)


def test_names_of_signals_are_kept_select_and_connect():
    motor = (K * ct.tf(1, [1, 1, 0])).with_names(inputs=["u"], outputs=["angle"])
    brake = ct.ss(ct.tf([2.0], [0.1, 1.0]), inputs="e", outputs="u", name="C")
    error = ct.summing_junction(["r", "-angle"], "e")
    loop = connect(motor, brake, error, inputs=["r"], outputs=["angle", "e", "u"])
    assert (loop.inputs, loop.outputs) == (("r",), ("angle", "e", "u"))
    assert loop.substitute({}).output_labels == ["angle", "e", "u"]
    L = at(ct.tf(1, [1, 1, 0])).item() * at(brake).item()
    for values in loop.sample(3, seed=0):
        member, k = loop.substitute(values), values["k"]
        assert at(member)[:, 0] == pytest.approx([k * L / (1 + k * L), 1 / (1 + k * L), at(brake).item() / (1 + k * L)])
        picked = loop[["u", "angle"], "r"].substitute(values)
        assert at(picked) == pytest.approx(at(member)[[2, 0]], rel=SAME)
    assert loop[1:, 0].outputs == ("e", "u")
    assert loop[-1, 0].outputs == ("u",)
    for wrong, message in (
        (lambda: connect(motor, brake, inputs=["e"], outputs=["force"]), "no signal is named 'force'"),
        (lambda: connect(motor, motor, inputs=["u"], outputs=["angle"]), "two systems make 'angle'"),
        (lambda: connect(motor, brake, inputs=[], outputs=["angle"]), "nothing makes 'e'"),
        (lambda: connect(motor, error, inputs=["u"], outputs=["e"]), "nothing makes 'r'"),
        (lambda: connect(K, inputs=[], outputs=[]), "every signal must have a name"),
        (lambda: motor.with_names(inputs=["a", "b"]), "there are 1 inputs, but 2 names"),
    ):
        with pytest.raises(ValueError, match=message):
            wrong()


def test_values_are_physical_and_nothing_is_extrapolated():
    assert [values["m"] for values in M.grid(3)] == pytest.approx([1.6, 2.0, 2.4])
    assert len((M * K).grid(4)) == 16
    for deviation in ({"percent": (-10, 50)}, {"plus_minus": (-1, 5)}, {"range": (9, 15)}):
        block = ureal("a", 10, **deviation).blocks[0]
        assert (block.low, block.nominal, block.high) == pytest.approx((9, 10, 15))
    c = ucomplex("c", 5.0, 0.5)
    assert at((c * c + c).substitute({"c": 5.4})).item() == pytest.approx(5.4**2 + 5.4)
    assert (c * c + c).blocks[0].repeats == 2
    unknown = ultidyn("d", bound=0.4)
    lag = ct.tf(0.4, [1, 1])
    assert at((1 + unknown).substitute({"d": lag})) == pytest.approx(1 + at(lag), rel=SAME)


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (lambda: M.substitute({"m": 2.5}), r"parameter 'm' is 2.5, must be in \[1.6, 2.4\]"),
        (lambda: M.substitute({"m": 2.0 + 0.1j}), r"parameter 'm' is \(2\+0.1j\)"),
        (lambda: M.substitute({"q": 1.0}), "unknown parameter 'q', there are m"),
        (lambda: ultidyn("d").substitute({"d": ct.tf(1.1, [1, 1])}), "block 'd' has the size 1.1, must be at most 1"),
        (lambda: ultidyn("d").substitute({"d": ct.tf(1, [1, -1])}), "block 'd' has the size inf"),
        (lambda: ucomplex("c", 1, 0.5).substitute({"c": 1.6}), "block 'c' has the size 0.6, must be at most 0.5"),
        (lambda: 1 / ureal("d", range=(-1, 2)), r"singular for some 'd' in \[-1, 2\]"),
        (lambda: 1 / ureal("d", range=(0, 2)), r"singular for some 'd' in \[0, 2\]"),
        (lambda: 1 / (M - K / 1.5), "nominal feedthrough"),
        (lambda: 1 / (M - K / 2), "singular for some"),
        (lambda: 1 / (K * ct.tf(1, [1, 1])), "nominal feedthrough"),
        (lambda: M + ureal("m", 2.0, percent=10), "'m' has two meanings: m: real, 2 in"),
        (lambda: ultidyn("F", 2, 2) @ ultidyn("F", 2, 2), "block 'F' occurs twice"),
        (lambda: (M * ct.tf(1, [1, 0.5], 0.1)) * ct.tf(1, [1, 1]), "sample times differ: continuous and 0.1 s"),
        (lambda: feedback(M * np.eye(2), np.ones((2, 3))), "the feedback of 2 x 2 by 2 x 3"),
        (lambda: feedback(M, -0.5), "the feedback is not well posed"),
        (lambda: M * np.eye(2) + np.ones((3, 3)), "the sum of systems of 2 x 2 and 3 x 3"),
        (lambda: (M * np.eye(2)) @ np.ones((3, 1)), "the product of systems of 2 x 2 and 3 x 1"),
        (lambda: uss([[0, 1]], [[1]], [[1]], [[0]]), "A is 1 x 2, B 1 x 1, C 1 x 1, D 1 x 1: sizes do not fit"),
        (lambda: uss([[M * np.eye(2)]], 1, 1, 0), "entry 1, 1 of the matrix is 2 x 2, must be one number"),
        (lambda: ultidyn("d", (2, 2)), r"give two whole numbers, of outputs and inputs: ultidyn\('d', 2, 3\)"),
        (lambda: ucomplex("c", 1 + 1j, 0.3), r"block 'c' has the nominal value \(1\+1j\), must be real"),
        (lambda: M.substitute({"m": K}), "parameter 'm' is Uncertain"),
        (lambda: ucomplex("c", 1, 0.5).substitute({"c": "1"}), "block 'c' is '1', must be a number"),
        (lambda: ureal("a", 1.0, percent=(-1, 2, 3)), r"\(-1, 2, 3\) must be two numbers"),
        (lambda: uss(M, 1, 1, 0, True), "dt is True"),
        (lambda: Uncertain(M=np.eye(2)), "ndarray is no linear system"),
        (lambda: hinf_norm(M * G), "an uncertain system is a family: take a member by substitute"),
        (lambda: ureal("a", 1.0), "give one of range, percent, plus_minus"),
        (lambda: ureal("a", percent=10), "a deviation needs the nominal value"),
        (lambda: ureal("a", 0.0, percent=10), "needs finite low < nominal < high"),
    ],
)
def test_what_has_no_value_is_refused_by_name(write, message):
    with pytest.raises(ValueError, match=message):
        write()


@pytest.mark.parametrize("size", [1e-12, 1e-6, 1e9])
def test_an_inverse_keeps_the_digits_of_far_units(size):
    inverse = 1 / append(ureal("c", size, percent=20) * ct.tf([1, 2], [1, 1]), 3.0)
    found = at(inverse.substitute({"c": 1.1 * size}))
    assert found == pytest.approx(np.diag([(POINT + 1) / (POINT + 2) / (1.1 * size), 1 / 3]), rel=1e-14)


def test_systems_from_elsewhere_are_operands_and_entries():
    theirs = scipy.signal.StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    for write in (
        lambda: M * theirs,
        lambda: Uncertain(M=theirs) * M,
        lambda: append([[M, 0]]) * append(theirs, theirs) * [[1], [2]],
    ):
        assert at(write().substitute({"m": 2.4})).item() == pytest.approx(2.4 / (POINT + 1))
    assert at(append([[G, M], [0, 1]]).substitute({})) == pytest.approx(np.array([[at(G).item(), 2.0], [0, 1]]))
    assert at(uss([], [], [], M).substitute({})) == pytest.approx(2.0)


def test_a_number_over_s_is_proper():
    assert at((M / ct.tf("s")).substitute({"m": 2.4})) == pytest.approx(2.4 / POINT)
    with pytest.raises(ValueError, match="no state space"):
        M * ct.tf("s")


def test_what_is_no_index_or_exponent_is_told():
    for wrong, kind, message in (
        (lambda: M["m"], TypeError, "outputs, inputs"),
        (lambda: M[2, 0], IndexError, "output 2 of a system that has 1"),
        (lambda: M["y", 0], KeyError, "no output is named 'y'"),
        (lambda: (M * H)[np.array([True, False]), :], TypeError, "by number or name"),
        (lambda: feedback(M, 1, "+"), TypeError, r"the sign of the feedback is '\+'"),
        (lambda: uss(-M, 1, 1, None), TypeError, "the matrix None has entries that are no numbers or systems"),
        (lambda: M**0.5, TypeError, "must be an integer"),
        (lambda: M + None, TypeError, "None is no system, matrix or number"),
        (lambda: M * "k", TypeError, "'k' is no system"),
        (lambda: M * np.array([[1j]]), ValueError, "D has complex numbers"),
        (lambda: M / 0, ValueError, "no inverse"),
        (lambda: (M * G).poles(), AttributeError, r"no 'poles', a member has: substitute\(\{\}\) is the nominal one"),
    ):
        with pytest.raises(kind, match=message):
            wrong()


def test_a_system_shows_itself_in_ten_lines():
    wide = append(*(ureal(f"p{k}", range=(0, 1)) for k in range(12)))
    shown = str(wide).splitlines()
    assert len(shown) == 10
    assert shown[0] == "Uncertain: 12 outputs, 12 inputs, 0 states, continuous"
    assert shown[-1] == "... and 4 more"
    assert "<th>p11</th><td>real, 0.5 in [0, 1], occurs once</td>" in wide._repr_html_()
