"""Every field that a command prints with --json stands in the reference, with its meaning."""

import json
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer.main
from typer.testing import CliRunner

from gustproof.cli.app import app
from gustproof.guide.documents import Document, list_documents
from gustproof.guide.rendering import heading_anchor

DOCUMENTS = {document.title: document for document in list_documents()}
ANCHORED = {heading_anchor(title): document for title, document in DOCUMENTS.items()}
SEEN = tomllib.loads((Path(__file__).parent / "json_paths.toml").read_text(encoding="utf-8"))
QUICK = {
    "law list": "Shipped files",
    "vehicle list": "Shipped files",
    "design list": "Shipped files",
    "scenario list": "Shipped files",
}


def paths(value: Any, above: str = "") -> Iterator[str]:
    """Yield the path of each field of a JSON value, `[]` for each array."""
    for name, part in value.items() if isinstance(value, dict) else ():
        yield f"{above}{name}"
        yield from paths(part, f"{above}{name}.")
    for part in value if isinstance(value, list) else ():
        yield from paths(part, f"{above.removesuffix('.')}[]." if above else "")


def patterns(document: Document, depth: int = 0) -> Iterator[str]:
    """Yield patterns of the paths that the reference explains, those of linked tables too."""
    for name, meaning in document.fields.items():
        parts = [".+".join(map(re.escape, re.split(r"<[^>]+>", part))) for part in name.split(".")]
        yield from (r"\.".join(parts[:count]).removesuffix(r"\[\]") for count in range(1, len(parts) + 1))
        for anchor in re.findall(r"\]\(#([\w-]+)\)", meaning) if depth < 4 else ():
            above = "" if name == "<figure>" else r"\.".join(parts).removesuffix(r"\[\]") + r"(\[\])?\."
            yield from (above + below for below in patterns(ANCHORED[anchor], depth + 1))


def unexplained(title: str, seen: set[str]) -> list[str]:
    known = [re.compile(pattern) for pattern in set(patterns(DOCUMENTS[title]))]
    return sorted(path for path in seen if not any(pattern.fullmatch(path) for pattern in known))


@pytest.mark.parametrize("title", SEEN)
def test_every_field_that_was_printed_is_explained(title: str) -> None:
    assert unexplained(title, set(SEEN[title].split())) == []


@pytest.mark.parametrize(("command", "title"), QUICK.items())
def test_every_field_that_is_printed_is_explained(command: str, title: str) -> None:
    result = CliRunner().invoke(app, [*command.split(), "--json"])
    assert unexplained(title, set(paths(json.loads(result.stdout)))) == []


def test_a_field_that_no_table_has_is_found() -> None:
    assert unexplained("A comparison", {"Ms", "slow"}) == ["slow"]


def test_every_field_has_a_meaning() -> None:
    assert [(title, name) for title, each in DOCUMENTS.items() for name, text in each.fields.items() if not text] == []


def test_every_command_with_json_has_a_document() -> None:
    told = " ".join(document.about for document in DOCUMENTS.values())
    for name, command in typer.main.get_command(app).commands.items():
        parts = {f"{name} ": command} if not hasattr(command, "commands") else {}
        assert all(
            re.search(rf"`{each}", told)
            for each, part in parts.items()
            if "--json" in {option for parameter in part.params for option in parameter.opts}
        ), name
