"""The one law form and its file."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from firmware_model.config.vehicle import load_vehicle
from gustproof.law.form import Law, LawFileError, Provenance, doubt_vehicle, find_vehicle, load_law, parse_law
from gustproof.law.write.matrices import read_law, save_mat

Maker = Callable[..., Law]


@pytest.mark.parametrize("limited", [False, True])
@pytest.mark.parametrize("measured", [6, 8])
def test_a_file_keeps_every_bit(make_law: Maker, tmp_path: Path, measured: int, limited: bool) -> None:
    law = make_law(measured=measured, limited=limited)
    law.save(tmp_path / "law.json")
    back = load_law(tmp_path / "law.json")
    for name in ("A", "B", "C", "D", "G", "H", "limits"):
        assert getattr(back, name).tobytes() == getattr(law, name).tobytes()
    assert (back.name, back.dt, back.output, back.provenance) == (law.name, law.dt, law.output, law.provenance)
    assert (back.rate_limit is not None) == limited
    for name in ("S", "T", "U", "V", "limits") if limited else ():
        assert getattr(back.rate_limit, name).tobytes() == getattr(law.rate_limit, name).tobytes()


def test_a_file_keeps_every_bit_of_a_schedule(make_law: Maker, turn: Maker, tmp_path: Path) -> None:
    law = turn(make_law(scheduled=False))
    law.save(tmp_path / "law.json")
    back = load_law(tmp_path / "law.json")
    assert back.is_scheduled
    assert back.schedule is not None
    assert law.schedule is not None
    assert back.schedule.parameters == law.schedule.parameters
    for name in ("limits", "J", "K", "L", "P", "Q"):
        assert getattr(back.schedule, name).tobytes() == getattr(law.schedule, name).tobytes()
    assert "schedule" not in make_law().to_dict()


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("parameters", [], "schedule.parameters: are .*, must be of phi, theta, p, q, r"),
        ("parameters", ["phi", "psi", "r", "r"], "schedule.parameters: are .*'psi'"),
        ("parameters", "phi", "schedule.parameters: are 'phi'"),
        ("limits", [3.2, 0.2, 0.5, 0.5], "schedule.limits: phi up to 3.2, must be above 0 and below 3.142"),
        ("limits", [math.pi, 0.2, 0.5, 0.5], "schedule.limits: phi up to 3.14159, must be above 0 and below 3.142"),
        ("limits", [0.3, 0.2, 0.0, 0.5], "schedule.limits: r up to 0"),
        ("J", [[0.0] * 6] * 4, r"schedule.J has shape \(4, 6\), must be \(4, 7\)"),
        ("L", [[0.5] * 4] * 4, "schedule.L has the largest singular value 2, must be below 1"),
        ("L", np.eye(4).tolist(), "schedule.L has the largest singular value 1, must be below 1"),
        ("Q", [[math.nan] * 4] * 7, "schedule.Q has a number that is not finite"),
        ("W", 1, "schedule: must be an object of J, K, L, P, Q, limits, parameters"),
    ],
)
def test_a_wrong_schedule_is_refused(make_law: Maker, turn: Maker, key: str, value: object, message: str) -> None:
    document = json.loads(json.dumps(turn(make_law()).to_dict()))
    document["schedule"][key] = value
    with pytest.raises(LawFileError, match=message):
        parse_law(document, "file")


def test_attitude_and_rates_of_a_schedule_or_of_kinematics_are_six_states(make_law: Maker, turn: Maker) -> None:
    with pytest.raises(ValueError, match="schedule: A has order 5"):
        turn(make_law(5, scheduled=False))
    assert turn(make_law(6, scheduled=False)).is_scheduled
    with pytest.raises(ValueError, match="G is not 0 but A has order 5"):
        make_law(5)
    assert make_law(6).has_kinematics


def test_a_law_without_a_limit_of_the_rate_has_no_trace_of_one_in_its_file(make_law: Maker) -> None:
    law = make_law()
    assert "rate_limit" not in law.to_dict()
    assert law.attitude_limits.tolist() == [math.inf] * 3


def test_the_attitude_limit_is_the_attitude_that_commands_the_limited_rate(make_law: Maker) -> None:
    law = make_law(limited=True)
    assert law.rate_limit is not None
    for axis, angle in enumerate(law.attitude_limits):
        assert abs(law.rate_limit.S[axis, axis] * angle) == pytest.approx(law.rate_limit.limits[axis], rel=1e-12)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("limits", [1.0, 0.0, 1.0], "rate_limit.limits are .*, must be positive"),
        ("limits", [1.0, 1.0], r"rate_limit.limits has shape \(2,\)"),
        ("T", [[0.0] * 8] * 3, r"rate_limit.T has shape \(3, 8\), must be \(3, 6\)"),
        ("V", [[math.nan] * 3] * 7, "rate_limit.V has a number that is not finite"),
        ("S", [[0.0] * 7] * 3, "rate_limit.S must command a rate from the attitude"),
        ("W", 1, "rate_limit: must be an object of S, T, U, V, limits"),
    ],
)
def test_a_wrong_limit_of_the_rate_is_refused(make_law: Maker, key: str, value: object, message: str) -> None:
    document = json.loads(json.dumps(make_law(limited=True).to_dict()))
    document["rate_limit"][key] = value
    with pytest.raises(LawFileError, match=message):
        parse_law(document, "file")


@pytest.mark.parametrize(("states", "is_refused"), [(2, True), (3, False)])
def test_a_limit_of_the_rate_needs_the_attitude_in_the_state(make_law: Maker, states: int, is_refused: bool) -> None:
    law = make_law(limited=True)
    assert law.rate_limit is not None
    limit = replace(law.rate_limit, S=np.eye(3, states), V=np.zeros((states, 3)))
    parts = {"A": law.A[:states, :states], "B": law.B[:states], "C": law.C[:, :states], "H": law.H[:states]}
    refused = ""
    try:
        replace(law, **parts, G=np.zeros((states, 3)), rate_limit=limit)
    except ValueError as error:
        refused = str(error)
    assert bool(refused) is is_refused


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("A", [[math.nan]], "A"),
        ("D", [[1.0, 2.0]], r"D has shape \(1, 2\), must be \(3, 6\)"),
        ("D", [[0.0] * 8] * 3, r"B has shape \(7, 6\), must be \(7, 8\)"),
        ("rate_limit", 3.0, "rate_limit: must be an object"),
        ("D", [[math.inf] * 6] * 3, "D has a number that is not finite"),
        ("C", "text", "C|could not convert"),
        ("dt", 0.0, "dt is 0.0, must be from 0.0005 to 0.1 s"),
        ("dt", 4.0, "dt is 4.0, must be from 0.0005 to 0.1 s"),
        ("dt", "fast", "dt: is 'fast', must be a number"),
        ("dt", True, "dt: is True"),
        ("limits", [True, 1.0, 1.0], "limits: has true or false in the place of a number"),
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


def test_a_law_of_an_own_vehicle_is_for_its_numbers_whatever_the_name(tmp_path: Path) -> None:
    paper = load_vehicle("paper")
    own, pid = replace(paper, name="iris", mass=11.0), load_law("pid-fair")
    law = replace(pid, provenance=Provenance.of(own, "by hand", {}))
    law.save(tmp_path / "own.json")
    save_mat(law, tmp_path / "own.mat")
    for read in (load_law(tmp_path / "own.json"), read_law(str(tmp_path / "own.mat"))):
        assert read.provenance == law.provenance
        assert read.provenance.shipped_vehicle is None
        for name in ("iris", "paper", "my twin \u2708"):
            assert doubt_vehicle(read, replace(own, name=name)) == ""
            assert doubt_vehicle(read, replace(paper, name=name)) != ""
    assert "vehicle_digest" not in replace(pid, provenance=Provenance.of(paper, "by hand", {})).to_dict()["provenance"]


@pytest.mark.parametrize(
    ("names", "kind"),
    [({"scenario": "gust-roll"}, "scenario"), ({"controller": "flagship"}, "law"), ({"vehicle": "iris"}, "vehicle")],
)
def test_a_name_in_place_of_what_it_names_is_told(names, kind):
    (name,) = names.values()
    said = rf"'{name}' is a name: a flight takes a {kind}, such as load_{kind}\('{name}'\)"
    with pytest.raises(ValueError, match=said):
        find_vehicle(**{"controller": load_law("flagship"), "vehicle": None, **names})
