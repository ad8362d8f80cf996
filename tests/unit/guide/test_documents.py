"""Every field that a command prints with --json stands in the reference, with its meaning."""

import json
import re
import tomllib
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
import typer.main
from typer.testing import CliRunner

from gustproof.cli.app import app
from gustproof.guide.documents import Document, list_documents
from gustproof.guide.rendering import heading_anchor
from gustproof.guide.schema_files import output_schema

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


JSON_TYPES = {"object": dict, "array": list, "string": str, "boolean": bool, "number": (int, float), "integer": int}


def fits(value: Any, schema: dict[str, Any], root: dict[str, Any]) -> bool:
    """Tell whether a value fits a schema; of JSON Schema, the part that those of output use."""
    if "$ref" in schema:
        return fits(value, root["$defs"][schema["$ref"].rpartition("/")[2]], root)
    if "anyOf" in schema and not any(fits(value, each, root) for each in schema["anyOf"]):
        return False
    kinds = [schema["type"]] if isinstance(schema.get("type"), str) else schema.get("type", ())
    if kinds and not any(value is None if kind == "null" else isinstance(value, JSON_TYPES[kind]) for kind in kinds):
        return False
    if isinstance(value, list):
        return all(fits(each, schema.get("items", {}), root) for each in value)
    for name, part in value.items() if isinstance(value, dict) else ():
        known = [each for pattern, each in schema.get("patternProperties", {}).items() if re.search(pattern, name)]
        known += [schema["properties"][name]] if name in schema.get("properties", {}) else []
        others = schema.get("additionalProperties", {})
        if not all(fits(part, each, root) for each in known or [others or {}]) or (not known and others is False):
            return False
    return True


def grow(paths: list[str]) -> dict[str, Any]:
    """Return a document with the fields of the paths, whose values are null."""
    document: dict[str, Any] = {}
    for path in sorted(paths):
        node = document
        *above, last = path.split(".")
        for part in above:
            name = part.removesuffix("[]")
            if node.get(name) is None:
                node[name] = [{}] if part.endswith("[]") else {}
            node = node[name][0] if part.endswith("[]") else node[name]
        node.setdefault(last.removesuffix("[]"), None)
    return document


@pytest.mark.parametrize("title", SEEN)
def test_what_was_printed_fits_the_schema_of_its_output_and_nothing_beside_it(title: str) -> None:
    schema, printed = output_schema(DOCUMENTS[title]), grow(SEEN[title].split())
    assert fits(printed, schema, schema)
    assert fits([printed, printed], schema, schema)
    assert not fits({**printed, "beside it": 1.0}, schema, schema)


@pytest.mark.parametrize(("field", "wrong"), [("seed", "one"), ("message", 3), ("peak_deg", "0.4 deg")])
def test_a_value_of_another_type_does_not_fit_the_schema(field: str, wrong: Any) -> None:
    schema = output_schema(DOCUMENTS["A flight"])
    assert fits({field: None}, schema, schema)
    assert not fits({field: wrong}, schema, schema)


@pytest.mark.parametrize("title", SEEN)
def test_every_field_that_was_printed_is_explained(title: str) -> None:
    assert unexplained(title, set(SEEN[title].split())) == []


@pytest.mark.parametrize(("command", "title"), QUICK.items())
def test_every_field_that_is_printed_is_explained(command: str, title: str) -> None:
    result = CliRunner().invoke(app, [*command.split(), "--json"])
    assert unexplained(title, set(paths(json.loads(result.stdout)))) == []
    schema = output_schema(DOCUMENTS[title])
    assert fits(json.loads(result.stdout), schema, schema)


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


NEWCOMERS = (
    "law laws|multirotor|MAVLink|H-infinity|moment moments|budget|bound bounds|exact arithmetic|gust gusts|PX4|"
    "ArduPilot|test stand|RMSE|slew|Ms|margin margins|delay in samples|gain gains|flagship|pid-fair|scenario|seed|"
    "envelope|p q r"
)
"""The 24 terms that a newcomer once met before the first moving picture; forms of one stand side by side."""


def terms_in(text: str) -> list[str]:
    """Return the newcomer's terms in a text."""
    forms = {
        each: [each] if each in ("exact arithmetic", "delay in samples", "test stand") else each.split()
        for each in NEWCOMERS.split("|")
    }
    return [term for term, words in forms.items() if any(re.search(rf"(?<![\w`]){word}(?!\w)", text) for word in words)]


def test_a_newcomer_meets_twelve_terms_at_most_before_the_first_moving_picture() -> None:
    readme = (Path(__file__).parents[3] / "README.md").read_text(encoding="utf-8")
    before, command, _ = readme.partition("gustproof fly gust-roll --view")
    assert command
    live = Path(str(files("gustproof.show.live") / "assets"))
    labels = " ".join(re.findall(r"names: \[(.*?)\]", (live / "view.js").read_text(encoding="utf-8"))).replace('"', " ")
    page = re.sub(r"<[^>]*>", " ", (live / "index.html").read_text(encoding="utf-8")) + labels + " flagship "
    prose = re.sub(r"\]\([^)]*\)|`[^`]*`", "", before)
    assert len(terms_in(prose + page)) <= 12, terms_in(prose + page)
    assert terms_in("Slew is told by p, of laws on a test stand; notslew") == ["law laws", "test stand", "p q r"]
