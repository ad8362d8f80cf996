"""What commands have in common."""

import json
import math

import numpy as np

from gustproof.cli.options import print_json, print_next


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
