"""Margins and worst cases by their names: closed forms, members on the edge, published figures, other units."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from control import ss, tf

from gustproof.robust import (
    append,
    diskmargin,
    feedback,
    hinf_norm,
    lft,
    mussv,
    ncfmargin,
    robgain,
    robstab,
    robust_hinfstruct,
    ucomplex,
    ultidyn,
    ureal,
    uss,
    wcgain,
    wcmargin,
)
from gustproof.robust.lti.margins import margins
from gustproof.robust.lti.state_space import Lti
from gustproof.robust.mu.singular_value import disk_margin_bounds
from gustproof.robust.uncertain.uncertain_system import Uncertain, system_from_matrix

CUBIC = tf(1, [1, 3, 3, 1])
FAST = {"accuracy": 0.01, "boxes": 1}
PID = tf([2.3 * 0.001 + 0.38, 2.3 + 3 * 0.001, 3], [0.001, 1, 0])


def spring_plant(share: float) -> Uncertain:
    """MATLAB's `tf(18, [1 1.8 k]) * (1 + share * delta)` with k = 10 within 40 % and an unknown delta."""
    k = ureal("k", 10.0, percent=40)
    plant = feedback(tf(18, [1, 1.8, 0]), k / 18)
    return plant * (1 + share * ultidyn("delta"))


@pytest.mark.slow
@pytest.mark.parametrize("bounds", [(3.0, 5.0), (3.5, 6.0)])
@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_the_edge_of_stability_is_a_value_in_the_parameters_own_unit(bounds, dt):
    gain = ureal("k", 4.0, range=bounds)
    loop = feedback(gain * (CUBIC if not dt else tf(0.02, [1, 0.5], dt)))  # k < 8 by Routh; k < 25 by its pole
    edge, found = 25.0 if dt else 8.0, robstab(loop)
    assert found.worst["k"] == pytest.approx(edge, rel=1e-6)
    assert found.omega == pytest.approx(math.pi / 0.1 if dt else math.sqrt(3.0), rel=1e-3)
    assert min(abs(abs(found.worst_member.poles()) - 1.0) if dt else abs(found.worst_member.poles().real)) < 1e-6
    delta = float(gain.blocks[0].delta(edge))
    assert found.lower <= delta * (1 + 1e-9)
    assert (found.lower, found.upper) == (pytest.approx(delta, rel=0.01), pytest.approx(delta, rel=1e-6))
    low, high = found.covered["k"]
    assert (low, high) == (pytest.approx(float(gain.blocks[0].value(-delta)), abs=0.02), pytest.approx(edge, rel=1e-3))
    assert loop.close({"k": -found.lower}).is_stable()
    assert str(found).splitlines()[1].startswith(f"k: {edge:g} of [{bounds[0]:g}, {bounds[1]:g}], covered [")


@pytest.mark.parametrize("unknown", [ucomplex("d", 0.0, 0.5), ultidyn("d", bound=0.5)], ids=["number", "dynamics"])
def test_a_complex_value_on_the_edge_is_a_member_there(unknown):
    P = tf(4, [1, 0.8, 4])
    loop = feedback(P * (1 + unknown) + 0.1 * P * unknown * unknown, 0.5)  # the unknown occurs twice
    found = robstab(loop, **FAST)
    assert found.upper <= 1.03 * found.lower
    poles = found.worst_member.poles()
    assert min(abs(poles - 1j * found.omega)) < 1e-4 * found.omega
    assert "of size" in str(found)
    assert wcgain(0.9 * found.lower * unknown, **FAST).lower == pytest.approx(0.45 * found.lower, rel=1e-6)


@pytest.mark.slow
def test_the_worst_member_has_the_worst_gain_and_no_sample_exceeds_the_bound():
    S = feedback(1, spring_plant(0.3) * PID)
    found, margin = wcgain(S, **FAST), robgain(S, 2.0, accuracy=0.05)
    assert hinf_norm(found.worst_member).gain == pytest.approx(found.lower, rel=1e-4)
    assert hinf_norm(margin.worst_member).gain == pytest.approx(2.0, rel=1e-3)
    assert margin.lower <= 1.0 if found.lower > 2.0 else margin.upper >= 1.0
    gains = [hinf_norm(S.substitute(values)).gain for values in S.sample(20, seed=2)]
    assert max(gains) <= found.upper
    assert found.plot().get_xlabel() == "frequency [rad/s]"
    assert robgain(S, 1.0).upper == 0.0
    alone = wcgain(ureal("d", range=(-0.1, 0.1)) * tf(1, [1, 1]))  # whose nominal gain is 0
    assert (alone.lower, alone.upper) == (pytest.approx(0.1), pytest.approx(0.1, rel=0.01))


@pytest.mark.slow
def test_units_similarity_and_the_order_of_blocks_change_no_margin():
    rng, found = np.random.default_rng(4), []
    for unit, swap in ((1.0, False), (1e6, True)):
        m, k = ureal("m", 2.0 * unit, percent=20), ureal("k", range=(3.0 * unit, 5.0 * unit))
        plant = CUBIC * (1 / m)
        loop = feedback(plant * k if swap else k * plant)
        assert [block.name for block in loop.blocks] == (["k", "m"] if swap else ["m", "k"])
        T, M = rng.normal(size=(3, 3)), loop.M
        turned = Lti(A=T @ M.A @ np.linalg.inv(T), B=T @ M.B, C=M.C @ np.linalg.inv(T), D=M.D)
        loop = Uncertain(M=turned, blocks=loop.blocks)
        edge, worst = robstab(loop, accuracy=0.02, boxes=1), wcgain(loop, accuracy=0.02, boxes=1)
        found.append([edge.lower, edge.upper, worst.lower, worst.upper, *(edge.worst[name] / unit for name in "mk")])
    assert found[1] == pytest.approx(found[0], rel=5e-3)


def badly_scaled() -> Lti:
    """Return the loop L3 of RobustAndOptimalControl.jl, test/test_diskmargin.jl."""
    A = np.eye(5)
    A[0, 2], A[1, 2], A[1, 3], A[3, 4], A[4, 4] = 9.84, 0.01, 2.14634e-6, -1.73983959887, 0.56597684805
    B = np.zeros((5, 3))
    B[0, 1:], B[2, 2], B[3:, 1] = (4.901416e-5, 1.9883878e-4), 4.041439e-5, (-0.02004649371, -0.00490141631)
    C = np.zeros((3, 5))
    C[0, 1], C[1, 0], C[2, 0], C[2, 2] = -0.83516488404, 186.74725411661, -7.44299057498, 7035.08410814126
    D = np.zeros((3, 3))
    D[1:, 0] = 34875.36444283988, 48304.01940122544
    return Lti(A=A, B=B, C=C, D=D, dt=0.01)


def slicot_matrix() -> np.ndarray:
    rows = "-1+6j 2-3j 3+8j 3+8j -5-9j -6+2j 4+2j -2+5j -6-7j -4+11j 8-7j 12-1j 5-4j -4-8j 1-3j -6+14j 2-5j 4+16j"
    half = np.array([complex(each) for each in rows.split()]).reshape(6, 3)
    return np.hstack([half, half])


def both(found) -> tuple[float, float]:
    return float(found.lower), float(found.upper)


def slicot() -> tuple[float, float]:
    return both(mussv(slicot_matrix(), [(-1, 0), (-1, 0), (2, 2), (1, 1), (1, 1)]))


def spring_loop(kind: Callable, *level: float) -> tuple[float, float]:
    return both(kind(feedback(1, spring_plant(0.5) * PID), *level))


def mu_at(omega: float) -> tuple[float, float]:
    return both(mussv(badly_scaled().response(omega)[0], [(1, 1)] * 3, accuracy=1e-5))


def julia_pid() -> tuple[float, float]:
    P = tf(1, [1, 0.2, 1]) * (1 + 0.2 * ultidyn("d"))
    return both(robstab(feedback(P * (1 + tf(2, [1, 0]) + tf([0.9, 0], [0.1, 1])))))


def julia_two_complex() -> tuple[float, float]:
    P = ss([[0, 1], [0, 0]], np.eye(2), [[1, 0]], np.zeros((1, 2)))
    plant = P * (np.eye(2) + append(ucomplex("a", 0, 1), ucomplex("b", 0, 1)))
    return both(robstab(feedback(plant, np.ones((2, 1)))))


def julia_two_real() -> tuple[float, float]:
    P = ss([[0, 1], [-1, -1]], np.eye(2), [[1, 1], [0, 1]], np.zeros((2, 2)))
    plant = P * (np.eye(2) + append(ureal("a", range=(-1, 1)), ureal("b", range=(-1, 1))))
    return both(robstab(feedback(plant, np.eye(2))))


def satellite_channel(loop: int) -> tuple[float, float]:
    """Bounds on the worst disk margin of one loop, the other one closed."""
    p, order = ureal("p", 10.0, percent=10), [loop, 1 - loop]
    P = uss([[-0.2, p], [-p, -0.2]], np.eye(2), [[1, p], [-p, 1]], np.zeros((2, 2)))
    L = P * (np.eye(2) + ultidyn("DEL", 2, 2, bound=0.1)) * [[1, -2], [0, 1]]
    return both(wcmargin(lft(L[order, order], -1.0)))


SPINNING = diskmargin(ss([[0, 10], [-10, 0]], [[1, -2], [0, 1]], [[1, 8], [-10, 1]], np.zeros((2, 2))))
INTEGRATOR = tf(4, [1, -0.001])
PUBLISHED = [
    ("robstab.html", lambda: spring_loop(robstab), (1.5960, 1.5993)),
    ("robgain.html", lambda: spring_loop(robgain, 1.5), (0.7821, 0.7837)),
    ("diskmargin.html", lambda: both(SPINNING.output), (0.4890, 0.4899)),
    ("wcdiskmargin.html", lambda: satellite_channel(0), (0.6147, 0.6160)),
    ("diskmargin.html", lambda: both(SPINNING.loops[0]), (2.0, 2.0)),
    ("diskmargin.html", lambda: both(SPINNING.loops[1]), (2.0, 2.0)),
    ("ncfmargin.html", lambda: (ncfmargin(INTEGRATOR, tf(1, 1)).margin,) * 2, (0.7069, 0.7069)),
    ("ncfmargin.html", lambda: (ncfmargin(INTEGRATOR, tf(10, 1)).margin,) * 2, (0.0995, 0.0995)),
    ("ncfmargin.html", lambda: (ncfmargin(tf([1, 2], [1, 5, 10]), tf(4.4, [1, 0])).margin,) * 2, (0.1961, 0.1961)),
    ("ncfmargin.html", lambda: both(robstab(feedback(INTEGRATOR + ultidyn("d")))), (0.9980, 1.0)),
    ("ncfmargin.html", lambda: both(robstab(feedback(INTEGRATOR + ultidyn("d"), 10.0))), (0.0998, 0.1000)),
    # SLICOT's is its upper bound; a Delta that needs 40.92 is found
    ("SLICOT, examples/AB13MD.res", slicot, (40.92, 41.74753408)),
    # five matrices of one loop: bounds of MATLAB's mussv, the lower one met to seven digits by that package
    ("test_diskmargin.jl", lambda: mu_at(0.01), (2.961017564832289e5, 2.96106140392723e5)),
    ("test_diskmargin.jl", lambda: mu_at(0.1), (2988.0921297303, 2988.4614923336)),
    ("test_diskmargin.jl", lambda: mu_at(1.0), (45.2684368322, 45.3111209111)),
    ("test_diskmargin.jl", lambda: mu_at(10.0), (3.3712186847, 3.3811562301)),
    ("test_diskmargin.jl", lambda: mu_at(100.0), (0.3488286208, 0.3489834242)),
    ("test_uncertainty.jl", julia_pid, (0.84, 0.84)),
    ("test_uncertainty.jl", julia_two_complex, (0.4824, 0.4824)),
    ("test_uncertainty.jl", julia_two_real, (2.0**0.5, 2.0**0.5)),
]
"""Page, what is bounded, and the bounds printed there: html of mathworks.com/help/robust/ref, jl of
RobustAndOptimalControl.jl/test."""


@pytest.mark.slow
@pytest.mark.parametrize(("page", "bound", "printed"), PUBLISHED, ids=range(len(PUBLISHED)))
def test_published_figures_are_met(page, bound, printed):
    low, high = bound()
    last = 0.6 * 10.0 ** -min(4, len(str(printed[1]).partition(".")[2]))
    assert low - last <= printed[1], page
    assert high + last >= printed[0], page
    assert high <= 1.011 * low


@pytest.mark.slow
def test_a_disk_margin_says_which_gains_and_phases_it_covers():
    assert SPINNING.output.gains == pytest.approx((0.6071, 1.6472), abs=1e-3)  # diskmargin.html
    assert SPINNING.output.phase_deg == pytest.approx(27.4762, abs=0.05)
    assert SPINNING.loops[0].gains == (0.0, math.inf)
    lag = tf(25, [1, 10, 10, 10])
    S = diskmargin(lag, skew=1.0).output  # its margin is 1 / Ms, that of T at the skew -1
    assert S.lower == pytest.approx(1.0 / hinf_norm(feedback(1, lag)).gain, rel=1e-6)
    assert S.gains[0] == pytest.approx(1.0 / (1.0 + S.lower))
    T = diskmargin(lag, skew=-1.0).output
    assert T.gains == pytest.approx((1.0 - T.lower, 1.0 + T.lower))
    assert str(diskmargin(lag, 1)) == str(diskmargin(lag, tf(1, 1)))
    assert str(diskmargin(lag, tf(1, 1))).count("\n") == 4
    assert float(mussv([[2.0]], [(-1, 1)]).upper) == pytest.approx(2.0)
    for wrong, message in (
        (lambda: diskmargin(tf(1, [1, -2])), "the loop is unstable"),
        (lambda: diskmargin(lag, skew=math.nan), "skew is nan"),
        (lambda: mussv(np.eye(3), [(1, 1)] * 2), r"the blocks need 2 x 2"),
        (lambda: mussv(np.eye(2), [(0, 0)] * 2), "must be at least 1 x 1"),
        (lambda: mussv(np.eye(2), [-1, -1]), "block 1 is -1, must be a pair"),
        (lambda: mussv(lag, [(1, 1)]), "M is a system: take its frequency response"),
        (lambda: robgain(ureal("a", range=(0, 1)) * lag, 0.0), "gamma is 0.0"),
        (lambda: robgain(lag, 10.0), "no blocks"),
        (
            lambda: robstab(feedback(ureal("k", range=(9, 10)) * CUBIC)),
            "unstable at Delta = 0, its nominal values: a pole at",
        ),
    ):
        with pytest.raises(ValueError, match=message):
            wrong()


@pytest.mark.slow
def test_the_disk_margin_of_a_badly_scaled_sampled_loop_is_tight():
    # .428 is the least D-scaled norm over 400 frequencies
    L = badly_scaled()
    lower, upper = disk_margin_bounds(L, accuracy=0.005)
    assert lower == pytest.approx(0.428, rel=0.03)
    assert upper == pytest.approx(0.428, rel=0.03)
    assert lower >= margins(L, ss([], [], [], -np.eye(3), 0.01)).input_disk


@pytest.mark.parametrize("size", [2.0**-565, 2.0**-70, 2.0**330])
def test_mu_of_a_multiple_is_the_multiple_of_mu(size):
    """Where squares are lost it was a millionth, where they overflow an error of numpy."""
    M, blocks = np.array([[0.5, 0.2], [0.1, 0.3]]), [(-1, 0), (1, 0)]
    assert both(mussv(size * M, blocks)) == pytest.approx([size * each for each in both(mussv(M, blocks))], rel=1e-6)


def test_mu_over_frequency_is_that_of_each_matrix():
    responses = badly_scaled().response([0.1, 1.0])
    found = mussv(responses, [(1, 1), (2, 2)])
    assert found.upper.shape == (2,)
    assert found.upper[1] == pytest.approx(float(mussv(responses[1], [(1, 1), (2, 2)]).upper))
    for M, Delta, lower in zip(responses, found.Delta, found.lower, strict=True):
        assert abs(np.linalg.det(np.eye(3) - M @ Delta)) < 1e-6
        assert np.linalg.norm(Delta, 2) == pytest.approx(1.0 / lower, rel=1e-2)
    assert str(found) == f"mu: {found.lower[0]:.6g} to {found.upper[0]:.6g}, the largest of 2"
    repeated = mussv(np.array([[0.0, 2.0], [3.0, 0.0]]), [(2, 0)])
    assert float(repeated.upper) == pytest.approx(math.sqrt(6.0), rel=1e-3)


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_one_parameter_has_an_exact_margin(dt):
    # where mu jumps at single frequencies, scalings alone leave 20 % open
    rng = np.random.default_rng(2)
    A = rng.normal(size=(4, 4))
    poles = np.linalg.eigvals(A)
    A = 0.9 * A / np.max(np.abs(poles)) if dt else A - (np.max(poles.real) + 0.3) * np.eye(4)
    plant = ss(A, rng.normal(size=(4, 3)), 0.2 * rng.normal(size=(3, 4)), 0.05 * rng.normal(size=(3, 3)), dt)
    mass = ureal("mass", range=(900.0, 1300.0), nominal=1000.0)
    loop = lft(append(*[0.004 * (mass - 1000.0)] * 3), plant)
    found = robstab(loop)
    assert found.upper == pytest.approx(found.lower, rel=1e-5)
    poles = found.worst_member.poles()
    assert min(abs(abs(poles) - 1.0) if dt else abs(poles.real)) < 1e-9
    for share in np.linspace(-0.999, 0.999, 400) * found.lower:
        assert loop.close({"mass": share}).is_stable()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(
    "blocks", [[(-1, 0)] * 3, [(-1, 0)] * 6, [(-2, 0), (2, 0), (2, 1)], [(-1, 0), (-1, 0), (2, 2)]], ids=str
)
def test_bounds_of_a_matrix_with_up_to_six_parameters_are_tight(seed, blocks):
    rng = np.random.default_rng(seed)
    w = sum(abs(p) for p, _ in blocks)
    z = sum(m or abs(p) for p, m in blocks)
    M = rng.normal(size=(z, w)) + 1j * rng.normal(size=(z, w))
    found = mussv(M, blocks)
    assert 0.0 < found.lower <= found.upper <= 1.01 * found.lower
    assert np.linalg.svd(np.eye(z) - M @ found.Delta, compute_uv=False)[-1] < 1e-8
    # a smaller Delta leaves the matrix regular: no random one is singular
    if all(m == 0 and p == -1 for p, m in blocks):
        inside = rng.uniform(-1.0, 1.0, size=(2000, w)) / found.upper
        assert np.min(np.abs(np.linalg.det(np.eye(z) - M * inside[:, None, :]))) > 0.0


def test_a_family_with_an_unstable_member_has_an_infinite_worst_gain():
    static = wcgain(feedback(ureal("a", range=(-1.0, 1.5)) * 2.0))
    assert (static.lower, static.upper, static.worst["a"]) == (math.inf, math.inf, pytest.approx(-0.5))
    found = wcgain(feedback(4 * CUBIC * (1 + ultidyn("d", bound=0.9))), **FAST)
    assert (found.lower, found.gap) == (math.inf, 0.0)
    assert max(found.worst_member.poles().real) > 0.0


def test_a_loop_that_no_delta_closes_has_no_end_of_its_margin():
    d = ultidyn("d")
    for open_chain in (tf(1, [1, 1]) * (1 + d), ureal("a", 1.0, percent=10) * tf(1, [1, 1]) * (1 + d)):
        found = robstab(open_chain)
        assert found.lower > 1e9
        assert (found.upper, found.worst, found.covered["d"]) == (math.inf, {}, found.lower)
    assert both(mussv(np.zeros((2, 2)), [(-1, 0), (1, 1)])) == (0.0, 0.0)
    assert both(mussv(np.diag([0.0, 2.0]), np.array([[-1.0, 0.0], [1.0, 1.0]]))) == pytest.approx((2.0, 2.0), rel=1e-3)


def test_a_pole_on_the_axis_is_told_and_a_member_on_the_edge_is_drawn():
    k = ureal("k", 1.0, percent=50)
    for marginal in (tf(1, [1, 0, 1]), tf(1, [1, 0])):
        with pytest.raises(ValueError, match="unstable at Delta = 0"):
            robstab(k * marginal)
        assert wcgain(k * marginal).lower == math.inf
    edge = robstab(feedback(k * ss(0.5, 1, 1, 0, 0.1)))
    assert edge.plot().get_ylim()[1] < 1e4  # of its own the pole at the last frequency goes to 1e16
    with pytest.raises(ValueError, match="no uncertain blocks"):
        robust_hinfstruct(ss(0.5, 1, 1, 0), 1, 1)


def test_a_search_without_an_accuracy_or_boxes_is_refused():
    loop = feedback(ureal("k", 4.0, percent=25) * CUBIC)
    for wrong, message in (
        (lambda: robstab(loop, accuracy=0.0), "accuracy is 0.0, must be between 0 and 1"),
        (lambda: robgain(loop, 3.0, accuracy=-1), "accuracy is -1"),
        (lambda: wcgain(loop, boxes=0), "boxes is 0, must be a whole number, 1 or more"),
        (lambda: wcmargin(loop, boxes=0.5), "boxes is 0.5"),
        (lambda: mussv(np.zeros((0, 1, 1)), [(1, 1)]), r"M has the shape \(0, 1, 1\)"),
        (lambda: mussv([[1.0]], [(0.5, 1)]), "must be a pair of whole numbers"),
        (lambda: ncfmargin(CUBIC, 1.0, sign=2), "sign is 2, must be -1 or 1"),
    ):
        with pytest.raises(ValueError, match=message):
            wrong()


def test_a_complex_number_that_occurs_twice_is_one_number():
    c = ucomplex("c", 1.0, 0.3)
    found = wcgain(c * c)
    assert 1.69 * (1.0 - 1e-6) <= found.upper <= 1.011 * 1.69
    assert found.lower <= 1.69 * (1.0 + 1e-9)
    assert abs(found.worst["c"] - 1.0) == pytest.approx(0.3)
    k = ureal("k", 1.0, percent=1)
    margin = robstab(feedback(k * c * c, -0.5))  # destabilised at c^2 k = 2
    assert (1.0 + 0.3 * margin.upper) ** 2 * (1.0 + 0.01 * margin.upper) == pytest.approx(2.0, rel=1e-3)
    assert margin.gap < 0.01


def test_the_worst_disk_margin_has_its_member():
    found = wcmargin(ureal("k", 4.0, percent=25) * CUBIC)
    worst = diskmargin(5.0 * CUBIC).output
    assert found.worst["k"] == pytest.approx(5.0)
    assert found.lower <= worst.upper <= 1.01 * found.lower


def test_the_worst_disk_margin_of_two_channels_is_within_a_percent_of_a_members():
    k, c = ureal("k", 1.0, percent=30), ureal("c", 0.5, percent=40)
    L = np.array([[1.0, 0.6], [-0.4, 1.0]]) * append(k * tf(2, [1, 2, 0]), c * CUBIC * 4)
    found = wcmargin(L)
    corners = [diskmargin(L.substitute(values)).output for values in L.grid(2)]
    assert found.lower <= min(each.upper for each in corners)
    worst = diskmargin(L.substitute(found.worst)).output
    assert worst.lower <= found.upper <= 1.01 * found.lower


@pytest.mark.slow
def test_a_margin_next_to_a_cliff_of_mu_is_bounded():
    # blog.csdn.net/m0_74071263/article/details/127940597: stabmarg.LowerBound 0.2722; mu is 0 next to its peak of 3.67
    q1, q2, unit = ureal("q1", 1.4, range=(0.3, 2.5)), ureal("q2", 0.85, range=(0.0, 1.7)), np.eye(4)
    slow, fast = 6 * q1 + 6 * q2 + 2 * q1 * q2, q1 + q2
    last = -slow * unit[:1] - fast * unit[1:2] - fast * unit[2:3] + unit[3:]
    known = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 0], [1.01, 3, 1, 0.0]])
    plant = system_from_matrix(unit[:, 2:3] * last + known, 3)
    found = robstab(feedback(plant), accuracy=0.03, boxes=4)
    assert 0.26 < found.lower <= 0.2728
    assert found.upper == pytest.approx(0.2727, abs=1e-4)
    edge = [found.worst[name] for name in ("q1", "q2")]
    a, p = sum(edge), math.prod(edge)
    assert (a + 1) * (a + 3) == pytest.approx(6 * a + 2 * p + 1.01, rel=1e-4)  # Routh


def test_a_value_beyond_infinity_is_told_without_a_warning(recwarn):
    # a range off the middle is a rational function of delta, as in MATLAB: the edge 3 is an infinite lag
    lag = ureal("lag", 1.0, range=(0.75, 1.5))
    found = robstab(feedback((1 / lag) * tf(1, [1, 0])))
    assert found.worst["lag"] == math.inf
    assert found.covered["lag"] == (pytest.approx(0.5, rel=1e-5), pytest.approx(1e6, rel=1.0))
    assert lag.blocks[0].interval(3.0) == (0.5, math.inf)
    assert not recwarn


@pytest.mark.slow
def test_a_margin_of_gain_ends_where_the_loop_has_no_solution_or_no_stable_nominal_member():
    loop = feedback((1 / ureal("m", 1.0, percent=20)) * tf([2, 1], [0.1, 1, 0, 0]))
    found = robgain(loop, 2.0, **FAST)  # next to a mass of 0, where 1 / m has no value
    assert found.lower <= found.upper <= 1.02 * found.lower
    assert found.covered["m"] == pytest.approx((1.0 - 0.2 * found.lower, 1.0 + 0.2 * found.lower))
    assert max(hinf_norm(loop.close({"m": share * found.lower})).gain for share in np.linspace(-1, 1, 41)) < 2.0
    with pytest.raises(ValueError, match="unstable at Delta = 0"):
        robgain(feedback(ureal("k", range=(9, 10)) * CUBIC), 2.0)
