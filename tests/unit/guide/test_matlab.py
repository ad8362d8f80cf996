"""The page for users of MATLAB: its blocks print what the page shows, its names are public."""

import inspect
import re
from contextlib import redirect_stdout
from importlib.resources import files
from io import StringIO

import pytest

import gustproof
from gustproof import robust

PAGE = (files("gustproof.guide") / "matlab.md").read_text(encoding="utf-8")
PAIRS = re.findall(r"^```python\n(.*?)^```\n\n```text\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL)


def test_every_block_is_followed_by_what_it_prints():
    assert len(PAIRS) == PAGE.count("```python\n") == PAGE.count("```text\n") == 6


@pytest.mark.slow
@pytest.mark.parametrize(("block", "shown"), PAIRS, ids=[shown.split("\n")[0] for _, shown in PAIRS])
def test_a_block_prints_what_the_page_shows(block, shown):
    printed = StringIO()
    with redirect_stdout(printed):
        exec(compile(block, "matlab.md", "exec"), {})
    assert printed.getvalue() == shown


def test_every_name_that_answers_is_public():
    rows = re.findall(r"^\| `[^|]*\| ([^|]*) \|", PAGE, flags=re.MULTILINE)
    names = {name for row in rows for name in re.findall(r"`(\w+)", row)}
    assert len(rows) >= 25
    assert names <= set(gustproof.__all__)
    # and every function of the toolbox answers something, here or in the text
    functions = {name for name in robust.__all__ if not inspect.isclass(getattr(robust, name))}
    assert {name for name in functions if f"`{name}" not in PAGE and f" {name}" not in PAGE} == set()
