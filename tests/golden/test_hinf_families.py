"""Three hundred plants of seven kinds: what breaks other programs, judged by a reference of 60 and more digits."""

from pathlib import Path

import numpy as np
import scipy.linalg

from gustproof.lti.state_space import Lti

SAVED = Path(__file__).parent / "hinf_families.json"
PLANTS = 300
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
