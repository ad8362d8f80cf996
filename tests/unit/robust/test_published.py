"""Figures that other programs print: SLICOT's examples, tests of Octave's control package, python-control, IQC-beta.

MATLAB's are in `mu/test_analyses.py`, those of LPVTools in `lpv/test_lpvsyn.py`, HIMAT in `golden/test_mu_examples.py`.
Not held against: MATLAB's transport aircraft and the demos of LTVTools and IQClab, which draw their bounds or read
data files and print no figure; of SMAC no copy with figures was found.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest
import scipy
from control import sample_system, ss, tf

from gustproof.robust import (
    Delay,
    Sector,
    Slope,
    Uncertain,
    append,
    certify_lft,
    diskmargin,
    feedback,
    h2_norm,
    h2syn,
    hinf_norm,
    margins,
    ncfmargin,
    ncfsyn,
    ultidyn,
    ureal,
    wcgain,
)

LAG = ss(-1.0, 1.0, 1.0, 0.0)
THIRD = ss(tf([24], [1, 6, 11, 6]))
SIXTH = np.array(
    [
        [-1, 0, 4, 5, -3, -2],
        [-2, 4, -7, -2, 0, 3],
        [-6, 9, -5, 0, 2, -1],
        [-8, 4, 7, -1, -3, 0],
        [2, 5, 8, -9, 1, -4],
        [3, -5, 8, 0, 2, -6.0],
    ]
)
READ = np.array([[1, -1, 2, -4, 0, -3], [-3, 0, 5, -1, 1, 1], [-7, 5, 0, -8, 2, -2.0]])


def matlab_system():
    A = [
        [-1.017041847539126, -0.224182952826418, 0.042538079149249],
        [-0.310374015319095, -0.516461581407780, -0.119195790221750],
        [-1.452723568727942, 1.7995860837102088, -1.491935830615152],
    ]
    B = [[0.312858596637428, -0.164879019209038], [-0.864879917324456, 0.627707287528727]]
    C = [[1.109273297614398, 0.077359091130425, -1.113500741486764]]
    return ss(
        A,
        [*B, [-0.030051296196269, 1.093265669039484]],
        [*C, [-0.863652821988714, -1.214117043615409, -0.006849328103348]],
        np.zeros((2, 2)),
    )


def third_order_sampled():
    A = [[2.417, -1.002, 0.5488], [2, 0, 0], [0, 0.5, 0]]
    return ss(A, [[1], [0], [0]], [[-0.424, 0.436, -0.4552]], 1, 0.1)


def own_margins(plant) -> tuple[float, float]:
    """Return gain and phase margin [deg] in unit negative feedback."""
    found = margins(plant, ss([], [], [], -1.0, plant.dt)).output[0]
    return found.gain_margin, math.degrees(found.phase_margin)


def three_resonances():
    A = scipy.linalg.block_diag([[0, 1], [-0.5, -2e-4]], [[0, 1], [-1, -2e-5]], [[0, 1], [-2, -2e-6]])
    C = np.array([[1.0, 0.0, 1.0, 0.0, 1.0, 0.0]])
    return ss(A, C.T, C, 0.0)


def resolvent(A) -> np.ndarray:
    """Return the distance of a matrix from one with a pole on the axis, and the frequency of that pole."""
    n = len(A)
    peak = hinf_norm(ss(A, np.eye(n), np.eye(n), np.zeros((n, n))))
    return np.array([1.0 / peak.gain, peak.omega])


AB13FD = [
    [246.5, 242.5, 202.5, -197.5],
    [-252.5, -248.5, -207.5, 202.5],
    [-302.5, -297.5, -248.5, 242.5],
    [-307.5, -302.5, -252.5, 246.5],
]
ROTATING = ss([[0, 10], [-10, 0]], np.eye(2), [[1, 10], [-10, 1]], np.zeros((2, 2)))
NOTCHED = tf([35, 3.5, 8.75], [1]) * tf(1, [100, 1]) * tf(1, [1, 0.22, 1]) * tf(100, [1, 0.8, 100])
COVARIANCE = ss([[-0.2, -0.5], [1, 0]], [[2], [0]], [[1, 0.5]], 0, 0.1)
FIGURES: list[tuple[str, Callable[[], object], object, float]] = [
    ("Octave @lti/norm.m", lambda: h2_norm(LAG), 0.7071, 1.5e-5),
    ("Octave @lti/norm.m", lambda: h2_norm(third_order_sampled()), 1.2527, 1.5e-5),
    ("Octave @lti/norm.m", lambda: hinf_norm(third_order_sampled()).gain, 2.7, 0.05),
    ("Octave covar.m", lambda: 5.0 * h2_norm(LAG) ** 2, 2.5, 1e-4),
    ("Octave covar.m", lambda: 5.0 * h2_norm(COVARIANCE) ** 2, 30.3167, 1e-4),
    ("Octave margin.m", lambda: own_margins(THIRD), (2.50, 35.43), 5.1e-3),
    ("Octave margin.m", lambda: own_margins(sample_system(THIRD, 0.3)), (1.41, 18.60), 5.1e-3),
    ("SLICOT AB13CD.res", lambda: hinf_norm(three_resonances()).gain, 0.5000000006e6, 1e-3),
    ("SLICOT AB13CD.res", lambda: hinf_norm(three_resonances()).omega, 1.414213562, 1e-9),
    ("SLICOT AB13FD.res", lambda: resolvent(AB13FD)[0], 0.39196472317e-2, 1e-12),
    ("SLICOT AB13FD.res", lambda: resolvent(AB13FD)[1], 0.98966520430, 1e-6),
    ("python-control sysnorm_test.py", lambda: h2_norm(sample_system(LAG, 0.1)), 0.223513699524858, 1e-8),
    ("python-control sysnorm_test.py", lambda: hinf_norm(matlab_system()).gain, 4.276759162964244, 1e-8),
    ("python-control sysnorm_test.py", lambda: h2_norm(matlab_system()), 2.237461821810309, 1e-13),
    ("python-control sysnorm_test.py", lambda: h2_norm(sample_system(matlab_system(), 0.1)), 0.707434962289554, 1e-13),
    ("python-control margin_test.py", lambda: own_margins(ss(tf([1], [1, 2, 3, 4])))[0], 2.0, 1e-6),
    ("python-control margin_test.py", lambda: own_margins(ss(0.01 * tf([-1, 10], [1, 3, 2])))[0], 300.0, 1e-4),
    ("python-control margin_test.py", lambda: own_margins(ss(NOTCHED)), (2.2716, 97.5941), 1.5e-3),
    ("python-control margin_test.py", lambda: disk()[0], 0.3754, 1e-3),
    ("python-control margin_test.py", lambda: disk()[1], 3.3, 0.05),
    ("python-control margin_test.py", lambda: disk()[2], 21.26, 0.05),
]
"""File, what is computed, what is printed there, and half of its last digit, or the tolerance stated there."""


def disk() -> tuple[float, float, float]:
    """Return the disk margin at the plant's output, its gain margin [dB] and its phase margin [deg]."""
    found = diskmargin(ROTATING, ss([], [], [], [[1, -2], [0, 1]])).output
    return found.upper, 20.0 * math.log10(found.gains[1]), found.phase_deg


@pytest.mark.slow
@pytest.mark.parametrize(("source", "computed", "printed", "digit"), FIGURES, ids=range(len(FIGURES)))
def test_a_figure_is_that_printed_by_another_program(source, computed, printed, digit):
    assert computed() == pytest.approx(printed, abs=digit), source


def test_the_distance_of_a_defective_matrix_lies_where_slicot_prints_it():
    # AB13ED.res brackets it; the distance is that of the matrix with the opposite sign
    assert 0.20929379255e-05 < resolvent(-0.1 * np.eye(5) - np.eye(5, k=1))[0] < 0.20793050504e-04


def test_the_margin_of_slicots_controller_is_the_largest():
    # SB10ID.res; its factor 1 asks for the optimum
    G = ss(SIXTH, [[-3, -4], [2, 0], [-5, -7], [4, -6], [-3, 9], [1, -2]], READ, [[1, -2], [0, 4], [5, -3]])
    A = [
        [-39.0671, 9.9293, 22.2322, -27.4113, 43.8655],
        [-6.6117, 3.0006, 11.0878, -11.4130, 15.4269],
        [33.6805, -6.6934, -23.9953, 14.1438, -33.4358],
        [-32.3191, 9.7316, 25.4033, -24.0473, 42.0517],
        [-44.1655, 18.7767, 34.8873, -42.4369, 50.8437],
    ]
    B = [
        [-10.2905, -16.5382, -10.9782],
        [-4.3598, -8.7525, -5.1447],
        [6.5962, 1.8975, 6.2316],
        [-9.8770, -14.7041, -11.8778],
        [-9.6726, -22.7309, -18.2692],
    ]
    C = [[-0.6647, -0.0599, -1.0376, 0.5619, 1.7297], [-8.4202, 3.9573, 7.3094, -7.6283, 10.6768]]
    K = ss(A, B, C, [[0.8466, 0.4979, -0.6993], [-1.2226, -4.8689, -4.5056]])
    assert ncfmargin(G, K, sign=1).margin == pytest.approx(ncfsyn(G).emax, rel=1e-4)


def test_h2syn_has_the_controller_of_slicot_and_octave():
    # SB10HD.res and Octave's h2syn.m
    B = [
        [-3, -4, -2, 1, 0],
        [2, 0, 1, -5, 2],
        [-5, -7, 0, 7, -2],
        [4, -6, 1, 1, -2],
        [-3, 9, -8, 0, 5],
        [1, -2, 3, -6, -2],
    ]
    D = [[0, 0, 0, -4, -1], [0, 0, 0, 1, 0], [0, 0, 0, 0, 1], [3, 1, 0, 1, -3], [-2, 0, 1, 7, 1]]
    K = h2syn(ss(SIXTH, B, np.vstack([READ, [[9, -3, 4, 0, 3, 7], [0, 1, -2, 1, -6, -2]]]), D), 2, 2).K
    assert np.abs(K.A[0] - [88.0015, -145.7298, -46.2424, 82.2168, -45.2996, -31.1407]).max() < 5.1e-5
    assert np.abs(K.B[:2] - [[3.7345, 3.4758], [-0.3020, 0.6530]]).max() < 5.1e-5
    assert np.abs(K.C[1] - [7.6899, -8.4558, -2.9642, 7.0365, -4.2844, 0.1390]).max() < 5.1e-5
    assert not K.D.any()


def iqc_loop(system, sign: float) -> Uncertain:
    """Return the loop v = G (f + sign w) from f to v, in which w is what a part makes of v."""
    G = ss(system)
    M = ss(G.A, np.hstack([sign * G.B, G.B]), np.vstack([G.C, G.C]), np.zeros((2, 2)))
    return Uncertain(M=M, blocks=ultidyn("w").blocks)


NARROW = 20 * 20 * tf([1, -0.5, 1], np.poly([-10, -20, -30]))
SECOND = ss([[-1, -2], [1, 0]], [[1], [0]], [[1, 1]], 0)
SCALAR = ureal("d", 0.0, plus_minus=0.25)
ROTOR = ss([[-0.21, -1], [1, 0]], [[0.8], [0]], [[0, 1]], 0)
IQC = [
    # -G (w + f) is the loop of -G, w and f alike
    ("iqc_sector_test", iqc_loop(ss([[-0.2, -1], [1, 0]], [[1], [0]], [[-1, -1]], 0), 1), Sector(), 25.97),
    ("iqc_slope_odd_test", iqc_loop(NARROW, -1), Slope(poles=(1.0,)), 28.99),
    (
        "iqc_cdelay_test",
        iqc_loop(ss([[-1, -2], [1, 0]], [[1], [0]], [[1, 1]], 0), -1),
        Delay(largest=0.5, poles=(1, 2)),
        9.50,
    ),
    ("iqc_tvscalar_test", SCALAR * feedback(ROTOR, SCALAR, sign=1), None, 22.6304),
]
"""Test of IQC-beta, kept at github.com/iqcbeta/iqc-toolbox; the loop, its part, and the gain printed there."""


@pytest.mark.parametrize(("test", "loop", "part", "printed"), IQC, ids=[row[0] for row in IQC])
def test_a_proved_gain_is_that_of_the_iqc_toolbox(test, loop, part, printed):
    found = certify_lft(loop, assumes={}, parts=part and {"w": part})
    assert found.proven
    assert found.gain == pytest.approx(printed, rel=8e-4), test
    assert found.lower_bound <= found.gain


def test_gains_of_unknown_dynamics_are_those_of_the_iqc_toolbox():
    # iqc_ltvnorm_test: 954.2745; one channel has a closed form
    resonant = ss(tf(0.8, [1, 0.21, 1]))
    found, g = wcgain(feedback(resonant, ultidyn("w", bound=0.26), sign=1)), hinf_norm(resonant).gain
    assert found.lower * (1.0 - 1e-4) <= g / (1.0 - 0.26 * g) <= found.upper < 1.006 * 954.2745
    assert found.lower > 0.99 * found.upper
    # iqc_ltiunmod_test: 2.8294
    parts = append(*(ss(tf(n, d)) for n, d in (([1, 0], [1, 100]), ([1, 0], [1, 80]), (10, [1, 10]), (8, [1, 8]))))
    M = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1]]) / 1.5 * parts * np.array([[1, 0], [1, 0], [1, 0], [0, 1]])
    found = wcgain(feedback(M, append(ultidyn("w1"), ultidyn("w2", 1, 2)), sign=1))
    assert found.lower <= 2.8294 <= found.upper <= 1.005 * 2.8294
