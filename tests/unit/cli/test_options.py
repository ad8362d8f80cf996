"""What commands have in common."""

import json
import math
import time
from pathlib import Path

import numba
import numpy as np
from numba.extending import overload

from firmware_model.numerics.compiled import is_compiling
from gustproof.cli import options
from gustproof.cli.options import print_json, print_next, progress


def test_numbers_that_json_does_not_have_become_null(capsys):
    print_json({"a": math.nan, "b": [math.inf, {"c": -math.inf}], "d": (1.5, np.float64("nan")), "e": None, "f": True})
    printed = capsys.readouterr().out
    found = json.loads(printed, parse_constant=lambda name: f"not JSON: {name}")
    assert found == {"a": None, "b": [None, {"c": None}], "d": [1.5, None], "e": None, "f": True}


def test_the_next_command_writes_no_file_that_is_there(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("law.json", "law-2.json"):
        (tmp_path / name).touch()
    print_next("judge", "law.json", "--better", "law.json", "-o", "page.html")
    assert capsys.readouterr().out == "next: gustproof judge law.json --better law-3.json -o page.html\n"
    print_next("report", Path("-run"), "-o", "-page.html")
    assert capsys.readouterr().out == "next: gustproof report ./-run -o ./-page.html\n"


def test_a_line_of_progress_says_that_machine_code_is_made(capsys, monkeypatch):
    monkeypatch.setattr(options, "_FIRST_LINE_S", 0.01)

    def step() -> None: ...

    def take_time():  # which numba asks for what stands in the place of `step`
        while not capsys.readouterr().err.startswith("gustproof: worst gust: compiling the simulator"):
            time.sleep(0.01)
        return lambda: None

    overload(step)(take_time)
    entry = numba.njit(lambda: step())
    with progress("worst gust", quiet=False):
        entry()
        assert not is_compiling()
