"""An error in a TOML file has the line of its key."""

import tomllib
from pathlib import Path

import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.toml_lines import find_line
from firmware_model.errors import ConfigError

TEXT = '''description = """
wind = 3
"""
[gyro]
noise = 1  # a remark
[[wind]]
kind = "constant"
[[wind]]
kind = "dryden"
  "speed" = 3
other.deep = 1
[a.b]
x = [
  1,
]
[[a.c]]
y = 1
[[a.c]]
[a.c.z]
y = 2
'''


@pytest.mark.parametrize(
    ("key", "line"),
    [
        (("description",), 1),
        (("gyro", "noise"), 5),
        (("wind", 0, "kind"), 7),
        (("wind", 1, "kind"), 9),
        (("wind", 1, "dryden", "speed"), 10),
        (("wind", 1, "missing"), 8),
        (("wind", 1, "other", "deep"), 11),
        (("a", "b", "x", 0), 13),
        (("a", "c", 0, "y"), 17),
        (("a", "c", 1, "z", "y"), 20),
        (("nowhere",), None),
    ],
)
def test_a_key_has_its_line(key: tuple[int | str, ...], line: int | None) -> None:
    assert tomllib.loads(TEXT)  # the lines are those of a sound file
    assert find_line(TEXT, key) == line


def test_an_error_in_the_second_of_many_tables_has_its_line(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('description = "x"\nduration_s = 1.0\n' + '[[wind]]\nkind = "constant"\nspeed_mps = 1.0\n' * 2)
    path.write_text(path.read_text() + "speed_mp = 1\nfrom_deg = nan\n")
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    assert "line 9, wind.1.constant.speed_mp: unknown key" in str(caught.value)
    assert "did you mean 'speed_mps'?" in str(caught.value)
    assert "line 10, wind.1.constant.from_deg: must be a finite number (given nan)" in str(caught.value)
