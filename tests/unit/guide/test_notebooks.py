"""Every notebook runs from top to end, prints little, and its check fails until the exercise is solved."""

import ast
import io
import json
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import pytest

from gustproof.guide import notebooks
from gustproof.guide.notebooks import NotebookCell, list_notebooks, make_notebook, split_cells
from gustproof.robust.shown import Shown

NOTEBOOKS = list_notebooks()
MOST_LINES = 40


def run(source: str, names: dict[str, Any]) -> str:
    """Run a cell, and return what a terminal would show of it, the value of its last expression too."""
    tree, printed = ast.parse(source), io.StringIO()
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    with redirect_stdout(printed):
        exec(compile(tree, "cell", "exec"), names)
        if isinstance(last, ast.Expr) and (value := eval(compile(ast.Expression(last.value), "cell", "eval"), names)):
            printed.write(f"{value}\n")
            assert not isinstance(value, Shown) or value._repr_html_().startswith("<table>")
    return printed.getvalue()


def cells(name: str) -> Iterator[NotebookCell]:
    return (cell for cell in split_cells(NOTEBOOKS[name]) if cell.kind != "text")


@pytest.mark.slow
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_runs_and_its_check_asks_for_the_exercise(name: str, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "__main__"}
    solution = ""
    for kind, source in cells(name):
        if kind == "solution":
            solution = source
            continue
        if kind == "check":
            with pytest.raises(AssertionError, match=r"\w"):
                run(source, dict(names))
            run(solution, names)
        shown = run(source, names)
        assert len(shown.splitlines()) <= MOST_LINES, source
        assert kind != "check" or shown.startswith("right: ")


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_has_one_exercise_and_is_a_file_of_nbformat(name: str) -> None:
    kinds = [cell.kind for cell in cells(name)]
    assert kinds[-3:] == ["exercise", "solution", "check"]
    assert kinds[:-3] == [""] * (len(kinds) - 3)
    document = json.loads(make_notebook(NOTEBOOKS[name]))
    assert (document["nbformat"], document["nbformat_minor"]) == (4, 5)
    code = ["".join(cell["source"]) for cell in document["cells"] if cell["cell_type"] == "code"]
    assert code == [cell.source for cell in cells(name) if cell.kind != "solution"]
    assert len({cell["id"] for cell in document["cells"]}) == len(document["cells"])
    assert any("One solution" in "".join(cell["source"]) for cell in document["cells"])


def test_a_block_of_another_kind_is_refused() -> None:
    with pytest.raises(ValueError, match="a block of kind 'excercise', must be one of exercise, solution, check"):
        list(split_cells("```python excercise\n1\n```\n"))


def test_examples_are_written_beside_the_notebooks(tmp_path: Path) -> None:
    notebooks.write_examples(tmp_path / "new")
    written = {path.name for path in (tmp_path / "new").iterdir()}
    assert {f"{name}.ipynb" for name in NOTEBOOKS} | {"geometric.py", "mpc.py"} <= written
