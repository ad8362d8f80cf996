from pathlib import Path

import pytest

from firmware_model.config.parameter_files import read_parameters, repeated_parameters
from gustproof.cli.laws import warn_of_repeated


def test_the_last_of_a_name_given_twice_counts_and_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.param"
    path.write_text("ATC_RAT_RLL_P 0.1\n@include b.parm\nATC_RAT_RLL_P,0.3\nATC_RAT_PIT_P 0.2\nATC_RAT_PIT_P 0.20\n")
    (tmp_path / "b.parm").write_text("# a comment\nATC_RAT_YAW_P 0.2\nATC_RAT_RLL_P 0.2\n")
    remarks = list[str]()
    assert read_parameters(path, "ardupilot", remarks)["ATC_RAT_RLL_P"] == "0.3"
    assert remarks == [
        "ATC_RAT_RLL_P 0.2 in b.parm line 3, 0.3 in a.param line 3: given twice, the last counts, as a ground station "
        "loads it"
    ]
    assert repeated_parameters(path, "ardupilot") == remarks
    warn_of_repeated(["", "none.param", str(path)], "ardupilot")
    assert capsys.readouterr().err == f"gustproof: warning: {remarks[0]}\n"
    path.write_text("@include b.parm\nATC_RAT_PIT_P 0.2\n")
    assert repeated_parameters(path, "ardupilot") == []


@pytest.mark.parametrize(("count", "end"), [(4, "9 in a.param line 8: given"), (6, "and 2 others: given")])
def test_many_names_given_twice_are_one_line(tmp_path: Path, count: int, end: str) -> None:
    path = tmp_path / "a.param"
    path.write_text("".join(f"MC_X{i} {value}\n" for value in (1, 9) for i in range(count)))
    (line,) = repeated_parameters(path, "px4")
    assert end in line
