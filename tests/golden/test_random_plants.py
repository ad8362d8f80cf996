"""Two hundred random plants, orders 2 to 30, full D matrices: the least level and the norms against other programs.

slycot's levels are saved, because it takes seconds a plant and does not return from some; to make them again, run
`python tests/golden/test_random_plants.py`. Where it claims less than we do, three judges that share no code with
`hinfsyn` settle it: the norm that its own controller reaches, the two Riccati equations solved by scipy's pencils, and
for small plants the linear matrix inequalities of which the least level is the optimum. (It overlooks eigenvalues of a
Hamiltonian on the imaginary axis.)
"""

import datetime
import json
import multiprocessing
from functools import cache
from pathlib import Path

import clarabel
import control
import numpy as np
import pytest
import scipy.linalg
import scipy.sparse
import slycot

from gustproof.errors import DesignError
from gustproof.robust.hinf.hinfsyn import HinfResult, hinfsyn
from gustproof.robust.lti.norms import hinf_norm
from gustproof.robust.lti.state_space import Lti, as_lti, lft

SAVED = Path(__file__).parent / "random_plants.json"
GOLDEN = json.loads(SAVED.read_text(encoding="utf-8")) if SAVED.exists() else {"plants": []}
PLANTS = 200
PATIENCE = 20.0
"""[s] after which slycot counts as hanging."""
AGREED = 1e-3
"""Relative: two levels are the same."""
SAME_NORM = 1e-6
"""Relative: two norms are the same; ab13dd is asked for 1e-10 and loses digits to rounding."""
ROUNDING = 1e-10
"""[-] gains that are rounding: the plants' are of order 1, and one loop cancels to 5e-12 or 7e-12 by machine."""
RESIDUAL = 1e-8
"""Relative to the terms of a Riccati equation; what solves it leaves 2e-10 at most, what does not 8e-6 at least."""
SMALL = 5
"""Orders up to this are given to the inequalities, whose cost grows with the sixth power."""


def random_plant(seed: int) -> tuple[Lti, int, int]:
    """Return a plant, some of its poles unstable, its number of measurements and of controls."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 31))
    p2, m2 = (int(count) for count in rng.integers(1, 4, 2))
    m1, p1 = p2 + int(rng.integers(0, 3)), m2 + int(rng.integers(0, 3))
    P = Lti(
        A=rng.normal(size=(n, n)) / np.sqrt(n) - rng.uniform(0.5, 1.5) * np.eye(n),
        B=rng.normal(size=(n, m1 + m2)),
        C=rng.normal(size=(p1 + p2, n)),
        D=rng.normal(size=(p1 + p2, m1 + m2)),
    )
    return P, p2, m2


@cache
def ours(seed: int) -> HinfResult | None:
    """Return our answer; None if it is a refusal, which is for rounding only."""
    try:
        return hinfsyn(*random_plant(seed))
    except DesignError as refusal:
        if "rounding spoilt" not in str(refusal):
            raise
        return None


def theirs(seed: int) -> dict[str, float | None]:
    """Return slycot's level and the norm, by two programs, of the loop that its controller closes; None: unstable."""
    P, n_meas, n_con = random_plant(seed)
    K, _, level, _ = control.hinfsyn(P.to_control(), n_meas, n_con)
    loop = lft(P, as_lti(K))
    norms = {
        "its_loop_hinf_norm": hinf_norm(loop).gain,
        "its_loop_ab13dd": float(control.norm(loop.to_control(), "inf")),
    }
    return {"slycot": float(level), **{name: norm if np.isfinite(norm) else None for name, norm in norms.items()}}


def parts(seed: int) -> tuple[np.ndarray, ...]:
    """Return A, B1, B2, C1, C2, D11, D12, D21."""
    P, n_meas, n_con = random_plant(seed)
    p1, m1 = P.n_outputs - n_meas, P.n_inputs - n_con
    return P.A, P.B[:, :m1], P.B[:, m1:], P.C[:p1], P.C[p1:], P.D[:p1, :m1], P.D[:p1, m1:], P.D[p1:, :m1]


def riccati_equations_allow(seed: int, gamma: float) -> bool:
    """Return whether a controller exists at a level, by Theorem 16.4 of Zhou, Doyle and Glover and scipy's solver."""
    A, B1, B2, C1, C2, D11, D12, D21 = parts(seed)
    solutions = []
    for F, G, H, J, width in (
        (A, np.hstack([B1, B2]), C1, np.hstack([D11, D12]), B1.shape[1]),
        (A.T, np.vstack([C1, C2]).T, B1.T, np.vstack([D11, D21]).T, C1.shape[0]),
    ):
        R = J.T @ J - gamma**2 * np.diag((np.arange(J.shape[1]) < width).astype(float))
        try:
            X = scipy.linalg.solve_continuous_are(F, G, H.T @ H, R, s=H.T @ J)
        except (np.linalg.LinAlgError, ValueError):  # eigenvalues on the axis, found or met in reordering
            return False
        # near the axis scipy returns what does not solve the equation
        K = X @ G + H.T @ J
        residual = F.T @ X + X @ F + H.T @ H - K @ np.linalg.solve(R, K.T)
        size = np.linalg.norm(X, 2) + 1.0
        if np.linalg.norm(residual, 2) > RESIDUAL * size * (np.linalg.norm(F, 2) + 1.0):
            return False
        if np.linalg.eigvalsh(X)[0] < -RESIDUAL * size:
            return False
        solutions.append(X)
    return np.max(np.abs(np.linalg.eigvals(solutions[0] @ solutions[1]))) < gamma**2


def least_level_by_inequalities(seed: int) -> float:
    """Return the least level as the optimum of three linear matrix inequalities in R, S and gamma.

    P. Gahinet, P. Apkarian, A linear matrix inequality approach to H-infinity control, Int. J. of Robust and Nonlinear
    Control 4 (1994), 421-448, Theorem 4.3.
    """
    A, B1, B2, C1, C2, D11, D12, D21 = parts(seed)
    n = A.shape[0]
    free = n * (n + 1) // 2
    upper = np.triu_indices(n)

    def symmetric(values: np.ndarray) -> np.ndarray:
        S = np.zeros((n, n))
        S[upper] = values
        return S + np.triu(S, 1).T

    def half(A, B1, C1, D11, R, gamma, directions):
        form = np.block(
            [
                [A @ R + R @ A.T, R @ C1.T, B1],
                [C1 @ R, -gamma * np.eye(C1.shape[0]), D11],
                [B1.T, D11.T, -gamma * np.eye(B1.shape[1])],
            ]
        )
        N = scipy.linalg.block_diag(scipy.linalg.null_space(directions), np.eye(B1.shape[1]))
        return -N.T @ form @ N

    def positive(x: np.ndarray) -> list[np.ndarray]:
        R, S, gamma = symmetric(x[:free]), symmetric(x[free : 2 * free]), x[-1]
        return [
            half(A, B1, C1, D11, R, gamma, np.hstack([B2.T, D12.T])),
            half(A.T, C1.T, B1.T, D11.T, S, gamma, np.hstack([C2, D21])),
            np.block([[R, np.eye(n)], [np.eye(n), S]]),
        ]

    def packed(forms: list[np.ndarray]) -> np.ndarray:
        columns = []
        for form in forms:
            j, i = np.tril_indices(form.shape[0])
            columns.append(form[i, j] * np.where(i == j, 1.0, np.sqrt(2.0)))
        return np.concatenate(columns)

    unknowns = 2 * free + 1
    constant = packed(positive(np.zeros(unknowns)))
    slopes = np.column_stack([packed(positive(unit)) - constant for unit in np.eye(unknowns)])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    cones = [clarabel.PSDTriangleConeT(form.shape[0]) for form in positive(np.zeros(unknowns))]
    solver = clarabel.DefaultSolver(
        scipy.sparse.csc_matrix((unknowns, unknowns)), np.eye(unknowns)[-1], scipy.sparse.csc_matrix(-slopes),
        constant, cones, settings,
    )  # fmt: skip
    return float(solver.solve().x[-1])


def agrees(seed: int) -> bool:
    result, level = ours(seed), GOLDEN["plants"][seed].get("slycot")
    return result is not None and level is not None and result.gamma_opt == pytest.approx(level, rel=AGREED)


def is_refuted(answer: dict[str, float | None], gamma_opt: float) -> bool:
    """Return whether slycot's level is below the least one, and the loop that its controller closes above it."""
    norms = (answer["its_loop_hinf_norm"], answer["its_loop_ab13dd"])
    kept = (1.0 - SAME_NORM) * gamma_opt
    return answer["slycot"] < gamma_opt and all(norm is None or norm > kept for norm in norms)


def test_nearly_every_plant_is_answered_and_most_are_judged_by_slycot():
    assert sum(ours(seed) is not None for seed in range(PLANTS)) >= 198
    assert sum("slycot" in plant for plant in GOLDEN["plants"]) >= 190
    assert sum(agrees(seed) for seed in range(PLANTS)) >= 140


@pytest.mark.parametrize("seed", range(PLANTS))
def test_the_least_level_is_slycots_or_slycot_is_refuted(seed):
    result, saved = ours(seed), GOLDEN["plants"][seed]
    if result is None or agrees(seed):
        return
    assert not riccati_equations_allow(seed, (1.0 - AGREED) * result.gamma_opt)
    if "slycot" in saved:
        assert is_refuted(saved, result.gamma_opt)


@pytest.mark.parametrize("seed", range(PLANTS))
def test_the_loop_is_stable_below_its_level_and_its_norm_is_slicots(seed):
    result, (P, n_meas, n_con) = ours(seed), random_plant(seed)
    if result is None:
        return
    loop = P.to_control().lft(result.K, n_con, n_meas)
    assert np.max(loop.poles().real) < 0.0
    assert result.norm < result.gamma
    told = max(ROUNDING, result.norm_error)
    assert control.norm(loop, "inf") == pytest.approx(result.norm, rel=SAME_NORM, abs=told)


@pytest.mark.parametrize("seed", [seed for seed in range(PLANTS) if random_plant(seed)[0].is_stable()])
def test_the_norm_of_a_stable_plant_is_slicots_and_no_frequency_exceeds_it(seed):
    P = random_plant(seed)[0]
    peak = hinf_norm(P)
    assert control.norm(P.to_control(), "inf") == pytest.approx(peak.gain, rel=SAME_NORM)
    gains = np.linalg.norm(P.response(np.geomspace(1e-3, 1e3, 500)), 2, axis=(1, 2))
    assert np.max(gains) <= (1.0 + SAME_NORM) * peak.gain


@pytest.mark.parametrize("seed", [seed for seed in range(PLANTS) if random_plant(seed)[0].order <= SMALL])
def test_the_least_level_of_a_small_plant_is_the_optimum_of_the_inequalities(seed):
    assert least_level_by_inequalities(seed) == pytest.approx(hinfsyn(*random_plant(seed)).gamma_opt, rel=AGREED)


@pytest.mark.parametrize("seed", [seed for seed in range(0, PLANTS, 4) if random_plant(seed)[0].order <= SMALL + 5])
def test_what_is_saved_is_what_slycot_says(seed):
    """Where slycot is wrong, how wrong depends on the machine's rounding: there it must be refuted here too."""
    saved = GOLDEN["plants"][seed]
    if "slycot" not in saved:
        return
    found, result = theirs(seed), ours(seed)
    same = found["slycot"] == pytest.approx(saved["slycot"], rel=AGREED)
    assert same or (result is not None and not agrees(seed) and is_refuted(found, result.gamma_opt))


def _write(seed: int, queue: "multiprocessing.Queue[dict[str, float | None]]") -> None:
    queue.put(theirs(seed))


def _judged(seed: int) -> dict[str, float | None]:
    """Return what slycot says in a process that can be ended; nothing if it must be."""
    queue: multiprocessing.Queue[dict[str, float | None]] = multiprocessing.Queue()
    process = multiprocessing.Process(target=_write, args=(seed, queue))
    process.start()
    process.join(PATIENCE)
    if process.is_alive():
        process.kill()
        return {}
    return queue.get(timeout=1.0)


if __name__ == "__main__":
    rows = [json.dumps({"seed": seed, **_judged(seed)}) for seed in range(PLANTS)]
    origin = {
        "program": f"control.hinfsyn of python-control {control.__version__} with slycot {slycot.__version__}; a plant "
        f"without a level is one from which it did not return in {PATIENCE:.0f} s",
        "command": "python tests/golden/test_random_plants.py",
        "date": datetime.date.today().isoformat(),
    }
    text = f'{{"origin": {json.dumps(origin)}, "plants": [\n' + ",\n".join(rows) + "\n]}\n"
    SAVED.write_text(text, encoding="utf-8")
