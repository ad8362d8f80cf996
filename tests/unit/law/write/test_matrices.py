import json
from dataclasses import replace

import numpy as np
import pytest
import scipy.io

from gustproof.law.form import LawFileError, Output, load_law
from gustproof.law.write.matrices import load_csv, load_mat, read_law, save_csv, save_mat

MATRICES = ("A", "B", "C", "D", "G", "H", "limits")


def assert_equal(law, read) -> None:
    assert (read.schedule and read.schedule.parameters) == (law.schedule and law.schedule.parameters)
    for name in ("J", "K", "L", "P", "Q", "limits") if law.schedule is not None else ():
        assert getattr(law.schedule, name).tobytes() == getattr(read.schedule, name).tobytes(), name
    for name in MATRICES:
        assert getattr(law, name).tobytes() == getattr(read, name).tobytes(), name
    assert (read.name, read.dt, read.output, read.provenance) == (law.name, law.dt, law.output, law.provenance)
    assert (read.rate_limit is None) == (law.rate_limit is None)
    for name in ("S", "T", "U", "V", "limits") if law.rate_limit is not None else ():
        assert getattr(law.rate_limit, name).tobytes() == getattr(read.rate_limit, name).tobytes(), name


FEELING = replace(
    load_law("hinf-d1"), B=np.random.default_rng(1).normal(size=(9, 8)), D=np.random.default_rng(2).normal(size=(3, 8))
)
NAMES = ("hinf-scheduled", "hinf-rates", "pid-fair", "aided")
LAWS = {"feeling force": FEELING, **{name: load_law(name) for name in NAMES}}


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_a_law_comes_back_from_matlab_and_from_tables_to_the_bit(law, tmp_path):
    save_mat(law, tmp_path / "law.mat")
    save_csv(law, tmp_path / "law")
    assert_equal(law, read_law(str(tmp_path / "law.mat")))
    assert_equal(law, read_law(str(tmp_path / "law")))


def test_a_scheduled_law_comes_back_and_its_schedule_is_whole(turn, tmp_path):
    test_a_law_comes_back_from_matlab_and_from_tables_to_the_bit(turn(load_law("aided")), tmp_path)
    (tmp_path / "law" / "K.csv").unlink()
    with pytest.raises(LawFileError, match="K: missing, a schedule has J, K, L, P, Q, schedule_limits"):
        load_csv(tmp_path / "law")


def test_four_matrices_of_the_gyro_and_a_sample_time_are_enough(tmp_path):
    law = load_law("hinf-d1")
    content = {"A": law.A, "B": law.B[:, :3], "C": law.C, "D": law.D[:, :3], "dt": law.dt}
    scipy.io.savemat(tmp_path / "mine.mat", content)
    read = load_mat(tmp_path / "mine.mat")
    assert read.B.tolist() == np.hstack([law.B[:, :3], np.zeros((law.order, 3))]).tolist()
    assert (read.name, read.output) == ("mine", Output.TORQUE)
    assert not read.is_scheduled
    assert np.all(np.isfinite(read.limits))


def test_what_is_missing_or_damaged_is_one_line(tmp_path):
    law = load_law("hinf-d1")
    scipy.io.savemat(tmp_path / "short.mat", {"A": law.A, "B": law.B, "C": law.C, "dt": law.dt})
    with pytest.raises(LawFileError, match=r"short\.mat: D: missing"):
        load_mat(tmp_path / "short.mat")
    save_mat(law, tmp_path / "cut.mat")
    (tmp_path / "cut.mat").write_bytes((tmp_path / "cut.mat").read_bytes()[:-200])
    with pytest.raises(LawFileError, match=r"cut\.mat"):
        load_mat(tmp_path / "cut.mat")
    (tmp_path / "text.mat").write_text("not one")
    with pytest.raises(LawFileError, match=r"text\.mat"):
        load_mat(tmp_path / "text.mat")
    with pytest.raises(LawFileError, match=r"none\.mat"):
        load_mat(tmp_path / "none.mat")


def test_a_limit_of_the_rate_is_whole_or_not_there(tmp_path):
    save_csv(load_law("pid-fair"), tmp_path / "law")
    (tmp_path / "law" / "U.csv").unlink()
    with pytest.raises(LawFileError, match="U: missing, a limit of the rate has S, T, U, V, rate_limits"):
        load_csv(tmp_path / "law")
    for name in ("S", "T", "V", "rate_limits"):
        (tmp_path / "law" / f"{name}.csv").unlink()
    assert load_csv(tmp_path / "law").rate_limit is None


@pytest.mark.parametrize(
    ("file", "content", "told"),
    [
        ("A.csv", "1,2\n3\n", "A.csv"),
        ("A.csv", "1,x\n", "A.csv"),
        ("B.csv", "1,2\n", "B has shape"),
        ("facts.json", "[1]", "dt: missing"),
        ("facts.json", "{", "facts.json"),
        ("facts.json", json.dumps({"dt": "soon"}), "soon"),
        ("facts.json", json.dumps({"dt": 0.004, "output": "thrust"}), "thrust"),
        ("facts.json", json.dumps({"dt": 0.004, "provenance": '{"colour": "red"}'}), "colour"),
    ],
)
def test_a_damaged_table_is_one_line(file, content, told, tmp_path):
    save_csv(load_law("hinf-d1"), tmp_path / "law")
    (tmp_path / "law" / file).write_text(content)
    with pytest.raises(LawFileError, match=told) as error:
        load_csv(tmp_path / "law")
    assert "\n" not in str(error.value)
