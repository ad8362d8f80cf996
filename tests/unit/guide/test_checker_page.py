"""The page about the checker leads through every file and theorem, in the order of imports."""

import ast
import re
from importlib.resources import files
from pathlib import Path

ROOM = Path(str(files("gustproof.checker")))
PAGE = (files("gustproof.guide") / "checker.md").read_text(encoding="utf-8")
PARTS = dict(re.findall(r"^- `(\w+)\.py`: (.*?)(?=^- `|^## |^Now|\Z)", PAGE, flags=re.MULTILINE | re.DOTALL))
"""Text of each file, in the order of the page."""
SOURCES = {path.stem: path.read_text(encoding="utf-8") for path in ROOM.glob("*.py") if path.stem != "__init__"}
FOLLOWED = re.compile(
    r"(?:(?i:theorem)(?: \d)? of|lemma of) [A-Z]\w+(?:, [A-Z]\w+)* and [A-Z]\w+|[A-Z]\w+'s inequality"
)
"""A result of others, named by its authors."""


def plain(text: str) -> str:
    """Return a text in one line, without marks."""
    return " ".join(text.replace("*", "").split())


def documented(source: str) -> list[str]:
    """Return the docstrings of a file, its own first."""
    nodes = ast.walk(ast.parse(source))
    kinds = ast.Module | ast.ClassDef | ast.FunctionDef
    return [plain(ast.get_docstring(node) or "") for node in nodes if isinstance(node, kinds)]


def test_every_file_stands_on_the_page_after_those_that_it_imports() -> None:
    order = list(PARTS)
    assert sorted(order) == sorted(SOURCES)
    for name, source in SOURCES.items():
        imported = re.findall(r"^\s*from gustproof\.checker\.(\w+) import", source, flags=re.MULTILINE)
        assert all(order.index(other) < order.index(name) for other in imported), name


def test_every_theorem_is_stated_with_its_file_as_there() -> None:
    stated = {}
    for name, source in SOURCES.items():
        if found := re.match(r"Theorem \d: .*?\.(?= |$)", documented(source)[0]):
            stated[name] = found[0]
            assert f"{found[0]}" in plain(PARTS[name])
    every = {number for source in SOURCES.values() for text in documented(source) for number in numbers(text)}
    assert sorted(text[:9] for text in stated.values()) == sorted(every)


def numbers(text: str) -> list[str]:
    """Return our own theorems that a text names."""
    return re.findall(r"Theorem \d(?! of)", text)


def test_every_result_of_others_is_named_with_its_file() -> None:
    named = {
        (name, each) for name, source in SOURCES.items() for t in documented(source) for each in FOLLOWED.findall(t)
    }
    assert len(named) > 2
    assert [(name, each) for name, each in sorted(named) if each.lower() not in plain(PARTS[name]).lower()] == []


def test_every_function_of_the_page_is_there_and_it_takes_an_hour() -> None:
    for name, text in PARTS.items():
        for function in re.findall(r"`(_?[a-z]+(?:_[a-z]+)+)`", text):
            assert re.search(rf"^def {function}\(", SOURCES[name], flags=re.MULTILINE), f"{name}: no {function}"
    assert sum(map(int, re.findall(r"^## .*: (\d+) minutes$", PAGE, flags=re.MULTILINE))) == 60
    lines = sum(source.count("\n") for source in SOURCES.values())
    told = int(re.findall(r"([\d,]+) lines", PAGE)[0].replace(",", ""))
    assert abs(lines - told) < 200
