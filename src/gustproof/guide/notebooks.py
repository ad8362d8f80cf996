"""Notebooks of the guide: Markdown here, `.ipynb` where they are written, with the examples beside them.

A block of Python is a cell. One of kind `exercise` leaves something open, and the `check` after it fails until that is
filled in. The `solution` between the two is folded away below the check.
"""

import json
import re
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

from firmware_model.config.whole_file import write_files

_BLOCK = re.compile(r"^```python ?(\w*)\n(.*?)^```\n", re.MULTILINE | re.DOTALL)
KINDS = ("", "exercise", "solution", "check")
"""Kinds of a block of Python."""


class NotebookCell(NamedTuple):
    """One cell of a notebook."""

    kind: str
    """One of `KINDS`; `text` is Markdown."""
    source: str
    """Text or Python, without a newline at its end."""


def list_notebooks() -> dict[str, str]:
    """Return the Markdown of each notebook by its name, in the order of the course."""
    folder = files("gustproof.guide") / "notebooks"
    found = {path.name.removesuffix(".md"): path.read_text(encoding="utf-8") for path in folder.iterdir()}
    return dict(sorted(found.items()))


def split_cells(text: str) -> Iterator[NotebookCell]:
    """Yield the cells of a notebook's Markdown.

    Raises
    ------
    ValueError
        If a block is of no kind.
    """
    at = 0
    for block in _BLOCK.finditer(text):
        if block[1] not in KINDS:
            raise ValueError(f"a block of kind '{block[1]}', must be one of {', '.join(KINDS[1:])}, or of none")
        if before := text[at : block.start()].strip():
            yield NotebookCell("text", before)
        yield NotebookCell(block[1], block[2].rstrip())
        at = block.end()
    if rest := text[at:].strip():
        yield NotebookCell("text", rest)


def make_notebook(text: str) -> str:
    """Return a notebook's Markdown as the JSON of nbformat 4.5."""
    cells: list[dict[str, Any]] = []
    solution = ""
    for kind, source in split_cells(text):
        if kind == "solution":
            solution = f"<details><summary>One solution</summary>\n\n```python\n{source}\n```\n\n</details>"
            continue
        cells.append(_cell(len(cells), source, is_code=kind != "text"))
        if kind == "check":
            cells.append(_cell(len(cells), solution, is_code=False))
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    about = {"kernelspec": kernel, "language_info": {"name": "python"}}
    return json.dumps({"cells": cells, "metadata": about, "nbformat": 4, "nbformat_minor": 5}, indent=1) + "\n"


def _cell(number: int, source: str, *, is_code: bool) -> dict[str, Any]:
    cell: dict[str, Any] = {"cell_type": "code" if is_code else "markdown", "id": f"cell-{number}", "metadata": {}}
    code = {"execution_count": None, "outputs": list[str]()} if is_code else {}
    return {**cell, **code, "source": source.splitlines(keepends=True)}


def example_files(folder: Path) -> dict[Path, str]:
    """Return the contents of the notebooks and of the examples of controllers, by their places in a folder."""
    notebooks = {folder / f"{name}.ipynb": make_notebook(text) for name, text in list_notebooks().items()}
    sources = (path for path in (files("gustproof.guide") / "examples").iterdir() if path.name.endswith(".py"))
    return notebooks | {
        folder / path.name: path.read_text(encoding="utf-8") for path in sources if path.name != "__init__.py"
    }


def write_examples(folder: Path) -> None:
    """Write the notebooks and examples of the guide into a folder, which is made if need be."""
    folder.mkdir(exist_ok=True)
    write_files(example_files(folder))
