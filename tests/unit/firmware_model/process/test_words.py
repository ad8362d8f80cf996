"""Options of a process in the words of its command."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pytest

from firmware_model.errors import ConfigError
from firmware_model.process.words import read_words


@dataclass
class Options:
    out_file: Path | None = None
    seed: int = 1
    held: bool = False
    via: Literal["torque", "rates"] = "torque"


def test_words_become_options():
    assert read_words(Options, []) == Options()
    words = ["--out-file", "a b", "--held", "--seed", "-7", "--via", "rates"]
    assert read_words(Options, words) == Options(Path("a b"), -7, True, "rates")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--heald"], "no such option: --heald; did you mean '--held'?"),
        (["held"], "no such option: held; did you mean '--held'?"),
        (["\x1b[2J"], r"no such option: \x1b[2J"),
        (["--seed"], "--seed: its value is missing"),
        (["--seed", "x"], "seed: "),
        (["--via", "thrust"], "via: input should be 'torque' or 'rates' (given 'thrust')"),
    ],
)
def test_a_wrong_word_is_told(words, told):
    with pytest.raises(ConfigError) as raised:
        read_words(Options, words)
    assert told in str(raised.value)
    assert str(raised.value).isprintable()
