"""No value of an analysis or a synthesis changes with the units of states, signals and time."""

import numpy as np
import pytest

from gustproof.robust.hinf.hinfsyn import hinfsyn
from gustproof.robust.lti.margins import Margins, margins
from gustproof.robust.lti.norms import h2_norm, hinf_norm
from gustproof.robust.lti.state_space import Lti, Matrix, lft
from gustproof.robust.uncertain.uncertain_system import Uncertain, simplify
from gustproof.robust.uncertain.uncertainty import FullBlock, RealBlock

DECADES = 6.0
"""Units are random factors from 1e-6 to 1e6."""
SYSTEMS = range(20)
"""Seeds; 200 were run when this was written."""
SLOW_OR_SAMPLED = (67, 82, 115, 117, 168, 189)
"""Seeds whose margins changed: crossings were found to 2e-12 rad/s, and poles of sampled loops taken for speeds."""
SAME = 1e-6
"""Relative; a coefficient in other units is rounded anew, and a loop near instability shows it."""
LEVEL = 1e-5
"""Relative; the least level is found to 1e-6."""


def draw_units(rng: np.random.Generator, count: int) -> Matrix:
    return np.asarray(10.0 ** rng.uniform(-DECADES, DECADES, size=count))


def random_system(rng: np.random.Generator, outputs: int, inputs: int) -> Lti:
    """Return a stable system: dense, or of light resonances over four decades; half of the dense ones are sampled."""
    n = 2 * int(rng.integers(1, 4))
    if rng.random() < 0.5:
        A = rng.normal(size=(n, n))
        A -= (np.max(np.linalg.eigvals(A).real) + 0.1) * np.eye(n)
    else:
        A = np.zeros((n, n))
        for k in range(0, n, 2):
            omega, zeta = 10.0 ** rng.uniform(-2.0, 2.0), 10.0 ** rng.uniform(-2.0, 0.0)
            A[k : k + 2, k : k + 2] = [[0.0, omega], [-omega, -2.0 * zeta * omega]]
    B, C, dt = rng.normal(size=(n, inputs)), rng.normal(size=(outputs, n)), 0.0
    if rng.random() < 0.5:
        dt = 0.5 / float(np.max(np.abs(np.linalg.eigvals(A))))
        A, B = np.linalg.solve(np.eye(n) - 0.5 * dt * A, np.eye(n) + 0.5 * dt * A), np.sqrt(dt) * B
    return Lti(A=A, B=B, C=C, D=np.zeros((outputs, inputs)), dt=dt)


def change(G: Lti, *, states: Matrix, inputs: Matrix, outputs: Matrix, time: float) -> Lti:
    """Return a system in other units: numbers of a quantity are multiplied by its factor, times by `time`."""
    rate = 1.0 if G.dt else 1.0 / time
    A, B = rate * G.A / states * states[:, None], rate * G.B * states[:, None] / inputs
    C, D = outputs[:, None] * G.C / states, outputs[:, None] * G.D / inputs
    return Lti(A=A, B=B, C=C, D=D, dt=G.dt * time)


@pytest.mark.parametrize("seed", SYSTEMS)
def test_norms_do_not_change(seed):
    rng = np.random.default_rng(seed)
    G = random_system(rng, int(rng.integers(1, 4)), int(rng.integers(1, 4)))
    time, factor = draw_units(rng, 2)
    other = change(
        G,
        states=draw_units(rng, G.order),
        inputs=np.full(G.n_inputs, 1.0 / factor),
        outputs=np.ones(G.n_outputs),
        time=time,
    )
    peak, same = hinf_norm(G), hinf_norm(other)
    assert same.gain / factor == pytest.approx(peak.gain, rel=SAME)
    if peak.gain > 1.001 * np.linalg.norm(G.response(1.01 * min(peak.omega, 1e9))[0], 2):
        assert same.omega * time == pytest.approx(peak.omega, rel=1e-3, abs=1e-9)  # a flat top hides where it is
    # noise of unit density has another power in another time; of unit variance a sample it has not
    assert h2_norm(other) * (1.0 if G.dt else np.sqrt(time)) / factor == pytest.approx(h2_norm(G), rel=SAME)


def random_loop(rng: np.random.Generator, width: int) -> tuple[Lti, Lti]:
    """Return a plant and a controller that stabilises it with positive feedback: their small gain does."""
    G, K = random_system(rng, width, width), random_system(rng, width, width)
    rate = float(np.max(np.abs(G.poles()))) / float(np.max(np.abs(K.poles())))
    K = Lti(A=K.A, B=K.B, C=K.C, D=0.3 * np.eye(width), dt=G.dt) if bool(K.dt) == bool(G.dt) else _static(width, G.dt)
    if K.order and not K.dt:
        K = Lti(A=rate * K.A, B=rate * K.B, C=K.C, D=K.D)
    factor = 0.9 / (hinf_norm(G).gain * hinf_norm(K).gain)
    return G, Lti(A=K.A, B=K.B, C=factor * K.C, D=factor * K.D, dt=K.dt)


def _static(width: int, dt: float) -> Lti:
    return Lti(A=np.zeros((0, 0)), B=np.zeros((0, width)), C=np.zeros((width, 0)), D=-0.3 * np.eye(width), dt=dt)


def figures(found: Margins) -> Matrix:
    """Return every margin, (k,): infinite ones as 0, what is small with the loop's gain as it is."""
    loops = [*found.input, *found.output]
    per_loop = [
        (loop.phase_margin, 1.0 / loop.gain_margin, loop.gain_reduction_margin, loop.Ms, loop.crossover)
        for loop in loops
    ]
    delays = [1.0 / loop.delay_margin for loop in loops]
    return np.array([*np.ravel(per_loop), *delays, found.input_disk, found.output_disk])


@pytest.mark.parametrize("seed", [*SYSTEMS, *SLOW_OR_SAMPLED])
def test_margins_do_not_change(seed):
    rng = np.random.default_rng(seed)
    width = int(rng.integers(1, 4))
    G, K = random_loop(rng, width)
    controls, measurements, time = draw_units(rng, width), draw_units(rng, width), float(draw_units(rng, 1)[0])
    other = margins(
        change(G, states=draw_units(rng, G.order), inputs=controls, outputs=measurements, time=time),
        change(K, states=draw_units(rng, K.order), inputs=measurements, outputs=controls, time=time),
    )
    expected, found = figures(margins(G, K)), figures(other)
    loops = 2 * width
    found[4 : 5 * loops : 5] *= time
    found[5 * loops : 6 * loops] *= time
    assert found == pytest.approx(expected, rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("seed", SYSTEMS)
def test_simplify_keeps_the_same_states_and_responses(seed):
    rng = np.random.default_rng(seed)
    blocks = (
        RealBlock(name="a", repeats=3, low=-1.0, high=1.0, nominal=0.0),
        FullBlock(name="b", n_outputs=1, n_inputs=1),
    )
    width = 5
    M = random_system(rng, width, width)
    unreached = int(rng.integers(0, M.order))
    A, B, D = M.A.copy(), M.B.copy(), 0.3 * rng.normal(size=(width, width)) / width
    A[unreached, np.arange(M.order) != unreached], B[unreached] = 0.0, 0.0
    A[unreached, unreached] = 0.5 if M.dt else -1.0
    D[2, :], B[:, 2] = 0.0, 0.0  # the third repetition drives nothing
    D[:, 2] = 0.0
    mixed = np.linalg.qr(rng.normal(size=(M.order, M.order)))[0]
    repeated = np.eye(width)
    repeated[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    M = Lti(
        A=mixed @ A @ mixed.T,
        B=mixed @ B @ repeated.T,
        C=repeated @ M.C @ mixed.T,
        D=repeated @ D @ repeated.T,
        dt=M.dt,
    )
    delta_units, time = draw_units(rng, 4), float(draw_units(rng, 1)[0])
    units = np.concatenate([delta_units, [1.0]])
    other = Uncertain(
        M=change(M, states=draw_units(rng, M.order), inputs=units, outputs=units, time=time), blocks=blocks
    )
    before = Uncertain(M=M, blocks=blocks)
    expected, found = simplify(before), simplify(other)
    assert (found.M.order, found.n_w) == (expected.M.order, expected.n_w)
    assert (expected.M.order, expected.n_w) == (before.M.order - 1, before.n_w - 1)
    delta = {"a": 0.5, "b": -0.7}
    omega = np.geomspace(1e-3, 1e2, 30) if not M.dt else np.linspace(0.0, np.pi / M.dt, 30)
    assert found.member(delta).response(omega / time) == pytest.approx(
        before.member(delta).response(omega), rel=SAME, abs=1e-9
    )


@pytest.mark.parametrize("seed", SYSTEMS)
def test_least_levels_do_not_change(seed):
    rng = np.random.default_rng(seed)
    P = random_system(rng, 4, 4)
    D = np.zeros((4, 4))
    D[2, 3], D[3, 2] = 1.0, 1.0  # the control is weighted, the measurement has noise
    P = Lti(A=P.A, B=P.B, C=P.C, D=D, dt=P.dt)
    control, measurement, factor, time = draw_units(rng, 4)
    other = change(
        P,
        states=draw_units(rng, P.order),
        inputs=np.array([1.0, 1.0, 1.0, control]),
        outputs=np.array([factor, factor, factor, measurement]),
        time=float(time),
    )
    expected, found = hinfsyn(P, 1, 1), hinfsyn(other, 1, 1)
    assert found.gamma_opt / factor == pytest.approx(expected.gamma_opt, rel=LEVEL)
    assert hinf_norm(lft(other, found.lti)).gain < found.gamma
