"""Three hundred plants of seven kinds: what breaks other programs, judged by levels computed in 90 digits.

The gate solves every ninth; all of them with `HINF_PLANTS=all pytest tests/golden/test_hinf_families.py`. The levels
are saved; to make them again, run `python tests/golden/test_hinf_families.py`, with python-flint installed.
"""

import json
import os
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

from gustproof.errors import DesignError
from gustproof.robust.hinf.conditions import SingularProblemError
from gustproof.robust.hinf.hinfsyn import hinfsyn
from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import Lti, lft

SAVED = Path(__file__).parent / "hinf_families.json"
GOLDEN = json.loads(SAVED.read_text(encoding="utf-8")) if SAVED.exists() else {"plants": []}
PLANTS = 300
COMPLEIB = json.loads((SAVED.parent / "compleib.json").read_text(encoding="utf-8"))["plants"]
SEEDS = range(0, PLANTS, 1 if os.environ.get("HINF_PLANTS") == "all" else 9)
TOLD = 1e-4
"""Relative error of a least level that is allowed."""
NEAR_ZERO = 1e-6
"""A level below this part of the gain from w to z is 0 or rounding."""
BEYOND_DOUBLES = 5e7
"""A level above this may be refused if the plant is very unstable: doubles then have too few digits of the loop."""
KINDS = ("generic", "damped", "non-minimal", "scaled", "unstable", "near-axis zero", "singular")


def kind_of(seed: int) -> str:
    """Return the kind of the plant of a seed."""
    return KINDS[seed % len(KINDS)]


def plant_of(seed: int) -> tuple[Lti, int, int]:
    """Return a plant, its number of measurements and of controls."""
    rng = np.random.default_rng(70_000 + seed)
    n, p2, m2 = (int(rng.integers(low, high)) for low, high in ((2, 7), (1, 3), (1, 3)))
    m1, p1 = p2 + int(rng.integers(0, 3)), m2 + int(rng.integers(0, 3))
    parts = {
        "A": rng.normal(size=(n, n)) / np.sqrt(n) - rng.uniform(0.0, 1.5) * np.eye(n),
        "B": rng.normal(size=(n, m1 + m2)),
        "C": rng.normal(size=(p1 + p2, n)),
        "D": rng.normal(size=(p1 + p2, m1 + m2)),
    }
    CHANGES[kind_of(seed)](rng, parts, p2, m2)
    return Lti(**parts), p2, m2


def _leave(rng, parts, p2, m2):
    """Change nothing."""


def _damp_lightly(rng, parts, p2, m2):
    """Give the state matrix pairs of poles with damping ratios from 1e-1 to 1e-8."""
    n = len(parts["A"])
    blocks = []
    while sum(len(block) for block in blocks) < n:
        frequency, zeta = 10.0 ** rng.uniform(-1, 1), 10.0 ** rng.uniform(-8, -1)
        pair = np.array([[-zeta, 1.0], [-1.0, -zeta]]) * frequency
        blocks.append(pair if n - sum(len(block) for block in blocks) > 1 else [[-frequency]])
    T = rng.normal(size=(n, n))
    parts["A"] = T @ scipy.linalg.block_diag(*blocks) @ np.linalg.inv(T)


def _add_hidden_modes(rng, parts, p2, m2):
    """Add a stable mode that nothing drives and one that nothing sees, and mix the states."""
    n = len(parts["A"])
    A = np.zeros((n + 2, n + 2))
    A[:n, :n], A[n, n], A[n + 1, n + 1] = parts["A"], -rng.uniform(0.1, 3.0), -rng.uniform(0.1, 3.0)
    A[:n, n], A[n + 1, :n] = rng.normal(size=n), rng.normal(size=n)
    B = np.vstack([parts["B"], np.zeros((1, parts["B"].shape[1])), rng.normal(size=(1, parts["B"].shape[1]))])
    C = np.hstack([parts["C"], rng.normal(size=(len(parts["C"]), 1)), np.zeros((len(parts["C"]), 1))])
    T = np.linalg.qr(rng.normal(size=(n + 2, n + 2)))[0]
    parts |= {"A": T @ A @ T.T, "B": T @ B, "C": C @ T.T}


def _scale_badly(rng, parts, p2, m2):
    """Scale states, controls and measurements each, w and z as a whole, by 1e-5 to 1e5."""
    x, u, y, w, z = (10.0 ** rng.uniform(-5, 5, size=size) for size in (len(parts["A"]), m2, p2, 1, 1))
    rows = np.concatenate([np.repeat(z, len(parts["C"]) - p2), y])
    columns = np.concatenate([np.repeat(w, parts["B"].shape[1] - m2), u])
    parts["A"] = parts["A"] * x[:, None] / x
    parts["B"] = parts["B"] * x[:, None] * columns
    parts["C"] = rows[:, None] * parts["C"] / x
    parts["D"] = rows[:, None] * parts["D"] * columns


def _destabilize(rng, parts, p2, m2):
    """Move all poles right, by up to 1000."""
    parts["A"] = parts["A"] + 10.0 ** rng.uniform(0.0, 3.0) * np.eye(len(parts["A"]))


def _hide_mode(rng, parts, rows, columns, zeros):
    """Give a plant zeros: modes of the state matrix that an input hides from all outputs."""
    n, k = len(parts["A"]), len(zeros)
    A, B, C, D = parts["A"].copy(), parts["B"][:, columns], parts["C"][rows], parts["D"][rows][:, columns]
    T, F = rng.normal(size=(n, n)), rng.normal(size=(B.shape[1], n))
    A[:, :k] = 0.0
    A[:k, :k], C[:, :k] = zeros, 0.0
    parts["A"] = T @ A @ np.linalg.inv(T) + B @ F
    parts["C"] = parts["C"].copy()
    parts["C"][rows] = C @ np.linalg.inv(T) + D @ F


def _give_zero(rng, parts, p2, m2, distance):
    """Give the plant a zero, or a pair, at a distance from the axis: from u to z, or from w to y."""
    frequency = rng.choice([0.0, 10.0 ** rng.uniform(-1, 1)])
    zeros = [[distance, frequency], [-frequency, distance]] if frequency else [[distance]]
    p1, m1 = len(parts["C"]) - p2, parts["B"].shape[1] - m2
    if rng.random() < 0.5:
        _hide_mode(rng, parts, slice(p1), slice(m1, None), zeros)
    else:
        dual = {"A": parts["A"].T, "B": parts["C"].T, "C": parts["B"].T, "D": parts["D"].T}
        _hide_mode(rng, dual, slice(m1), slice(p1, None), zeros)
        parts |= {"A": dual["A"].T, "B": dual["C"].T, "C": dual["B"].T}


def _give_near_zero(rng, parts, p2, m2):
    _give_zero(rng, parts, p2, m2, rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-12, -2))


def _make_singular(rng, parts, p2, m2):
    """Take rank from D12, from D21 or from both, or put a zero on the axis."""
    p1, m1 = len(parts["C"]) - p2, parts["B"].shape[1] - m2
    fault = int(rng.integers(0, 4))
    if fault in (0, 2):
        parts["D"][:p1, m1] = 0.0
    if fault in (1, 2):
        parts["D"][p1, :m1] = 0.0
    if fault == 3:
        _give_zero(rng, parts, p2, m2, 0.0)


CHANGES = dict(
    zip(
        KINDS,
        (_leave, _damp_lightly, _add_hidden_modes, _scale_badly, _destabilize, _give_near_zero, _make_singular),
        strict=True,
    )
)


@pytest.mark.parametrize("seed", SEEDS)
def test_level_is_that_of_ninety_digits_and_the_loop_keeps_it(seed):
    P, n_meas, n_con = plant_of(seed)
    level = GOLDEN["plants"][seed]["level"]
    try:
        result = hinfsyn(P, n_meas, n_con, regularize=True)
    except DesignError:
        assert level > BEYOND_DOUBLES
        assert kind_of(seed) == "unstable"
        return
    p1, m1 = P.n_outputs - n_meas, P.n_inputs - n_con
    size = np.linalg.norm(P.D[:p1, :m1], 2)
    cost = 3.0 * result.gamma_excess if np.isfinite(result.gamma_excess) else 0.02 * level
    assert abs(result.gamma_opt - level) <= max(TOLD * level, NEAR_ZERO * size, cost)
    assert result.norm < result.gamma
    if kind_of(seed) != "scaled":  # python-control refuses loops in such units
        loop = P.to_control().lft(result.K, n_con, n_meas)
        assert np.max(loop.poles().real) < 1e-9 * np.max(np.abs(loop.poles()))


@pytest.mark.parametrize("name", COMPLEIB)
def test_plant_of_compleib_is_solved_regularised_below_its_static_level(name):
    data = {key: np.array(COMPLEIB[name][key], dtype=float) for key in ("A", "B1", "B", "C1", "C", "D12")}
    n_meas, n_con, n_w = len(data["C"]), data["B"].shape[1], data["B1"].shape[1]
    P = Lti(
        A=data["A"],
        B=np.hstack([data["B1"], data["B"]]),
        C=np.vstack([data["C1"], data["C"]]),
        D=np.block(
            [[np.zeros((len(data["C1"]), n_w)), data["D12"]], [np.zeros((n_meas, n_w)), np.zeros((n_meas, n_con))]]
        ),
    )
    with pytest.raises(SingularProblemError):
        hinfsyn(P, n_meas, n_con)
    result = hinfsyn(P, n_meas, n_con, regularize=True)
    assert result.regularization > 0.0
    assert hinf_norm(lft(P, result.lti)).gain == pytest.approx(result.norm, rel=1e-6)
    assert result.gamma_opt - result.gamma_excess <= 1.001 * COMPLEIB[name]["gamma"]


REGULARIZED = 1e-12
"""Weight that makes a singular plant regular, whose level is then taken for its own."""


def _matrix(flint, M):
    return flint.acb_mat(*M.shape, [flint.acb(float(value)) for value in M.ravel()])


def _part(flint, M, rows, columns):
    return flint.acb_mat(len(rows), len(columns), [M[i, j] for i in rows for j in columns])


def _middle(flint, M):
    middles = [flint.acb(entry.real.mid(), entry.imag.mid()) for entry in M.entries()]
    return flint.acb_mat(M.nrows(), M.ncols(), middles)


def _riccati(flint, A, B, C1, D1, m1, gamma):
    """Return the stabilising solution at a level; None if there is none."""
    n, m = A.nrows(), B.ncols()
    J = flint.acb_mat(m, m, [flint.acb(float(i == j < m1)) for i in range(m) for j in range(m)])
    D1t, Bt = D1.transpose(), B.transpose()
    R = D1t * D1 - J * (gamma * gamma)
    RS, RB = _middle(flint, R.solve(D1t * C1)), _middle(flint, R.solve(Bt))
    F, G, Q = A - B * RS, B * RB, C1.transpose() * C1 - C1.transpose() * D1 * RS
    H = flint.acb_mat(2 * n, 2 * n)
    for i in range(n):
        for j in range(n):
            H[i, j], H[i, n + j], H[n + i, j], H[n + i, n + j] = F[i, j], -G[i, j], -Q[i, j], -F[j, i]
    values, V = _middle(flint, H).eig(right=True, algorithm="approx")
    stable = [i for i, value in enumerate(values) if float(value.real) < 0.0]
    largest = max(float(abs(value)) for value in values)
    if len(stable) != n or min(abs(float(value.real)) for value in values) < 1e-24 * largest:
        return None
    try:
        X = _middle(flint, _part(flint, V, range(n, 2 * n), stable) * _part(flint, V, range(n), stable).inv())
    except ZeroDivisionError:
        return None
    return flint.acb_mat(n, n, [flint.acb(((X[i, j] + X[j, i]).real / 2).mid()) for i in range(n) for j in range(n)])


def _is_feasible(flint, A, B, C, D, m1, p1, gamma):
    n, level = A.nrows(), flint.acb(gamma)
    X = _riccati(
        flint, A, B, _part(flint, C, range(p1), range(n)), _part(flint, D, range(p1), range(D.ncols())), m1, level
    )
    A, B, C, D = A.transpose(), C.transpose(), B.transpose(), D.transpose()
    if X is None:
        return False
    Y = _riccati(
        flint, A, B, _part(flint, C, range(m1), range(n)), _part(flint, D, range(m1), range(D.ncols())), p1, level
    )
    if Y is None:
        return False
    for S in (X, Y):
        values = [float(value.real) for value in S.eig(algorithm="approx")]
        if min(values) < -1e-22 * max(1e-30, *map(abs, values)):
            return False
    return max(float(abs(value)) for value in _middle(flint, X * Y).eig(algorithm="approx")) < gamma**2


def reference_level(seed: int) -> float:
    """Return the least level of a plant, by bisection in 90 digits; of a singular one, regularised by 1e-12."""
    import flint

    flint.ctx.dps = 90
    P, n_meas, n_con = plant_of(seed)
    p1, m1 = P.n_outputs - n_meas, P.n_inputs - n_con
    A, B, C, D = P.A, P.B, P.C, P.D
    left, right = scipy.linalg.null_space(D[:p1, m1:].T), scipy.linalg.null_space(D[p1:, :m1])
    floors = (left.T @ D[:p1, :m1], D[:p1, :m1] @ right)
    low = max([1e-12, *(np.linalg.norm(part, 2) for part in floors if part.size)])
    if kind_of(seed) == "singular":
        A, B, C, D = regularized(P, n_meas, n_con)
        m1, p1 = B.shape[1] - n_con, C.shape[0] - n_meas
    parts = tuple(_matrix(flint, M) for M in (A, B, C, D))
    high = max(1.0, 2.0 * low)
    while not _is_feasible(flint, *parts, m1, p1, high):
        low, high = high, 4.0 * high
    while high - low > 1e-7 * high and high > 1e-9:
        middle = max(np.sqrt(low * high), 0.25 * high) if low < 0.5 * high else 0.5 * (low + high)
        low, high = (low, middle) if _is_feasible(flint, *parts, m1, p1, middle) else (middle, high)
    return float(high)


def regularized(P: Lti, n_meas: int, n_con: int) -> tuple[np.ndarray, ...]:
    """Return the matrices of a plant with weights on states and controls, and noise on states and measurements."""
    n, p1, m1 = P.order, P.n_outputs - n_meas, P.n_inputs - n_con
    B = np.hstack([P.B[:, :m1], REGULARIZED * np.eye(n), np.zeros((n, n_meas)), P.B[:, m1:]])
    C = np.vstack([P.C[:p1], REGULARIZED * np.eye(n), np.zeros((n_con, n)), P.C[p1:]])
    D11, D12 = np.zeros((p1 + n + n_con, m1 + n + n_meas)), np.zeros((p1 + n + n_con, n_con))
    D21 = np.zeros((n_meas, m1 + n + n_meas))
    D11[:p1, :m1], D12[:p1], D21[:, :m1] = P.D[:p1, :m1], P.D[:p1, m1:], P.D[p1:, :m1]
    D12[p1 + n :], D21[:, m1 + n :] = REGULARIZED * np.eye(n_con), REGULARIZED * np.eye(n_meas)
    return P.A, B, C, np.block([[D11, D12], [D21, P.D[p1:, m1:]]])


if __name__ == "__main__":
    rows = [json.dumps({"seed": seed, "level": reference_level(seed)}) for seed in range(PLANTS)]
    origin = GOLDEN["origin"]
    text = f'{{"origin": {json.dumps(origin)}, "plants": [\n' + ",\n".join(rows) + "\n]}\n"
    SAVED.write_text(text, encoding="utf-8")
