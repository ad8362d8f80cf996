"""The one law form and its file."""

import json
import math
from collections.abc import Callable
from pathlib import Path

import pytest

from gustproof.errors import LawFileError
from gustproof.law.form import Law, load_law

Maker = Callable[..., Law]


@pytest.mark.parametrize("measured", [6, 9])
def test_a_file_keeps_every_bit(make_law: Maker, tmp_path: Path, measured: int) -> None:
    law = make_law(measured=measured)
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
def test_a_wrong_file_is_one_line_with_its_name_and_key(
    make_law: Maker, tmp_path: Path, key: str, value: object, message: str
) -> None:
    path = tmp_path / "law.json"
    make_law().save(path)
    document = json.loads(path.read_text())
    document[key] = value
    path.write_text(json.dumps(document))
    with pytest.raises(LawFileError, match=message) as caught:
        load_law(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_key_a_missing_file_and_an_unknown_name_are_said(make_law: Maker, tmp_path: Path) -> None:
    path = tmp_path / "law.json"
    make_law().save(path)
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


def test_arrays_of_a_law_can_not_be_changed(make_law: Maker) -> None:
    with pytest.raises(ValueError, match="read-only"):
        make_law().A[0, 0] = 1.0


def test_exact_kinematics_need_attitude_and_rates_in_the_state(make_law: Maker) -> None:
    with pytest.raises(ValueError, match="G is not 0 but A has order 3"):
        make_law(3)
