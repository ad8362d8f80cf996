"""What commands have in common."""

import json
import math

import numpy as np

from gustproof.cli.options import print_json


def test_numbers_that_json_does_not_have_become_null(capsys):
    print_json({"a": math.nan, "b": [math.inf, {"c": -math.inf}], "d": (1.5, np.float64("nan")), "e": None, "f": True})
    printed = capsys.readouterr().out
    found = json.loads(printed, parse_constant=lambda name: f"not JSON: {name}")
    assert found == {"a": None, "b": [None, {"c": None}], "d": [1.5, None], "e": None, "f": True}
