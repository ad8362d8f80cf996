"""Bars of notebooks, on a stand-in of IPython: the gate needs no Jupyter."""

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

import gustproof
from gustproof.show import notebook_progress
from gustproof.show.notebook_progress import with_bar


@pytest.fixture
def cell(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return what a cell shows, picture after picture; no time passes before the first."""
    shown: list[str] = []
    module: Any = ModuleType("IPython.display")
    module.HTML = str
    handle = SimpleNamespace(update=shown.append)
    module.display = lambda html, display_id: (shown.append(html), handle)[1]
    monkeypatch.setitem(sys.modules, "IPython.display", module)
    monkeypatch.setattr(notebook_progress, "_FIRST_S", 0.0)
    monkeypatch.setattr(notebook_progress, "_EACH_S", 0.0)
    return shown


def search(flights: int, *, progress=lambda *_: None) -> int:
    """Search."""
    progress(0.25, "a <gust>")
    progress(1, flights)
    progress("text alone")
    return flights


def test_a_bar_shows_any_kind_of_progress_and_leaves_nothing(cell):
    assert with_bar(search)(2) == 2
    assert cell == [
        "<progress value='0.250'></progress> 25% a &lt;gust&gt;",
        "<progress value='0.500'></progress> 50% search",
        "<progress value='0.000'></progress> 0% text alone",
        "",
    ]
    assert with_bar(search).__doc__ == "Search."


def test_who_gives_a_progress_of_his_own_sees_no_bar(cell):
    told: list[Any] = []
    with_bar(search)(2, progress=lambda *each: told.append(each))
    assert (cell, len(told)) == ([], 3)


def test_what_is_quick_shows_no_bar(cell, monkeypatch):
    monkeypatch.setattr(notebook_progress, "_FIRST_S", 60.0)
    with_bar(search)(2)
    assert cell == []


def test_only_a_notebook_gets_bars_and_only_where_there_is_progress(monkeypatch):
    plain = gustproof.tune_law
    monkeypatch.setitem(sys.modules, "ipykernel", ModuleType("ipykernel"))
    assert gustproof.tune_law.__wrapped__ is plain
    assert gustproof.load_law is with_bar(gustproof.load_law)
    monkeypatch.delitem(sys.modules, "ipykernel")
    assert gustproof.tune_law is plain
