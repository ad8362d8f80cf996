"""The one law form: its step, its kinematics, its file."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gustproof.errors import LawFileError
from gustproof.law import FlyingLaw, Law, Output, Provenance, euler_rates, load_law, step


def make(n: int = 7, *, scheduled: bool = True, seed: int = 1, measured: int = 6) -> Law:
    rng = np.random.default_rng(seed)
    return Law(
        name="test",
        A=0.3 * rng.normal(size=(n, n)) / math.sqrt(n),
        B=rng.normal(size=(n, measured)),
        C=rng.normal(size=(3, n)),
        D=rng.normal(size=(3, measured)),
        G=0.1 * rng.normal(size=(n, 3)) if scheduled else np.zeros((n, 3)),
        H=rng.normal(size=(n, 3)),
        dt=0.004,
        limits=np.array([0.5, 1.0, 2.0]),
        output=Output.TORQUE,
        provenance=Provenance(design="random", vehicle="none", parameters={"gamma": 0.25}),
    )


@pytest.mark.parametrize("measured", [6, 9])
@pytest.mark.parametrize("scheduled", [False, True])
def test_a_step_is_the_stated_form(scheduled: bool, measured: int) -> None:
    law = make(scheduled=scheduled, measured=measured)
    rng = np.random.default_rng(2)
    x, y = rng.normal(size=7), rng.normal(size=measured)
    phi, theta = x[0], x[1]
    T = np.array(
        [
            [1.0, math.sin(phi) * math.tan(theta), math.cos(phi) * math.tan(theta)],
            [0.0, math.cos(phi), -math.sin(phi)],
            [0.0, math.sin(phi) / math.cos(theta), math.cos(phi) / math.cos(theta)],
        ]
    )
    u = law.C @ x + law.D @ y
    command = np.clip(u, -law.limits, law.limits)
    assert np.any(command != u)
    expected = law.A @ x + law.B @ y + law.G @ (T @ x[3:6]) + law.H @ (command - u)
    x_next, flown = step(law, x, y)
    np.testing.assert_allclose(flown, command, rtol=1e-13)
    np.testing.assert_allclose(x_next, expected, rtol=1e-12, atol=1e-13)


def test_a_step_leaves_its_arguments_alone() -> None:
    law, x, y = make(), np.ones(7), np.ones(6)
    step(law, x, y)
    assert (x == 1.0).all()
    assert (y == 1.0).all()


FEELING = replace(make(measured=9), H=np.zeros((7, 3)), name="feeling force")
LAWS = {
    law.name: law
    for law in (FEELING, *(load_law(name) for name in ("pid-fair", "hinf-d1", "hinf-scheduled", "hinf-rates")))
}


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_a_flying_law_gives_the_bits_of_step(law: Law) -> None:
    scale, reference = (0.7, 1.5, 3.0), (0.1, -0.2, 0.3)
    flying, x = FlyingLaw(law, scale), np.zeros(law.order)
    flying.set_reference(reference)
    for gyro, force in np.random.default_rng(3).normal(size=(50, 2, 3)).tolist():
        x, command = step(law, x, np.array([*gyro, *reference, *force]))
        assert flying.step(tuple(gyro), tuple(force)) == tuple((command / scale).astype(np.float32).tolist())


def test_a_law_without_accelerometer_gives_the_same_bits_with_and_without_its_numbers() -> None:
    law, rng = make(), np.random.default_rng(4)
    x, y = rng.normal(size=7), rng.normal(size=9)
    for short, full in zip(step(law, x, y[:6]), step(law, x, y), strict=True):
        assert short.tobytes() == full.tobytes()


def test_a_law_that_feels_force_is_not_stepped_without_it() -> None:
    with pytest.raises(ValueError, match=r"y has shape \(6,\), must be \(9,\)"):
        step(make(measured=9), np.zeros(7), np.zeros(6))


@pytest.mark.parametrize("theta", [math.pi / 2.0, -math.pi / 2.0, 1.6])
def test_the_kinematics_stay_bounded_where_they_are_singular(theta: float) -> None:
    assert max(abs(rate) for rate in euler_rates((0.4, theta, 0.0), (1.0, 1.0, 1.0))) < 50.0


@pytest.mark.parametrize("measured", [6, 9])
def test_a_file_keeps_every_bit(tmp_path: Path, measured: int) -> None:
    law = make(measured=measured)
    law.save(tmp_path / "law.json")
    back = load_law(tmp_path / "law.json")
    for name in ("A", "B", "C", "D", "G", "H", "limits"):
        assert getattr(back, name).tobytes() == getattr(law, name).tobytes()
    assert (back.name, back.dt, back.output, back.provenance) == (law.name, law.dt, law.output, law.provenance)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("A", [[math.nan]], "A"),
        ("D", [[1.0, 2.0]], r"D has shape \(1, 2\), must be \(3, 6\)"),
        ("D", [[0.0] * 9] * 3, r"B has shape \(7, 6\), must be \(7, 9\)"),
        ("D", [[math.inf] * 6] * 3, "D has a number that is not finite"),
        ("C", "text", "C|could not convert"),
        ("dt", 0.0, "dt is 0.0, must be positive"),
        ("dt", "fast", "dt: is 'fast', must be a number"),
        ("dt", True, "dt: is True"),
        ("limits", [1.0, -1.0, 1.0], "limits are .*, must be positive"),
        ("output", "thrust", "output: is 'thrust', must be one of torque, rates"),
        ("format", "other", "format: must be"),
        ("surprise", 1, "surprise: unknown key"),
        ("provenance", {"author": "x"}, "provenance.author: unknown key"),
        ("provenance", 3, "provenance: must be an object"),
    ],
)
def test_a_wrong_file_is_one_line_with_its_name_and_key(tmp_path: Path, key: str, value: object, message: str) -> None:
    path = tmp_path / "law.json"
    make().save(path)
    document = json.loads(path.read_text())
    document[key] = value
    path.write_text(json.dumps(document))
    with pytest.raises(LawFileError, match=message) as caught:
        load_law(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_key_a_missing_file_and_an_unknown_name_are_said(tmp_path: Path) -> None:
    path = tmp_path / "law.json"
    make().save(path)
    document = json.loads(path.read_text())
    del document["H"]
    path.write_text(json.dumps(document))
    with pytest.raises(LawFileError, match="H: missing"):
        load_law(path)
    with pytest.raises(LawFileError, match="No such file"):
        load_law(tmp_path / "none.json")
    with pytest.raises(LawFileError, match="no law named 'nothing'"):
        load_law("nothing")
    path.write_text("{")
    with pytest.raises(LawFileError, match="not JSON"):
        load_law(path)


def test_arrays_of_a_law_can_not_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        make().A[0, 0] = 1.0


def test_exact_kinematics_need_attitude_and_rates_in_the_state() -> None:
    with pytest.raises(ValueError, match="G is not 0 but A has order 3"):
        make(3)
