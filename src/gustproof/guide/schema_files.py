"""Write JSON Schemas: of the TOML files, and of what `--json` prints.

Those of output are made from the reference of JSON output: its fields, with their meanings, and the types of the
models that print them. They allow no name that the reference lacks.
"""

import json
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

from firmware_model.config.whole_file import write_files
from gustproof.guide.documents import Document, list_documents
from gustproof.guide.rendering import heading_anchor
from gustproof.guide.schemas import KINDS, Schema, file_schema

_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_LINK, _ANY = re.compile(r"\]\(#([\w-]+)\)"), re.compile(r"<[^>]+>")


def write_schemas(folder: Path) -> list[Path]:
    """Write the schema of each kind of file, and of each output, to a folder, which is made, and return the files."""
    folder.mkdir(exist_ok=True)
    made = {path: make() for path, make in _list_schemas(folder).items()}
    write_files({path: json.dumps(schema, indent=2, ensure_ascii=False) + "\n" for path, schema in made.items()})
    return [*made]


def schema_files(folder: Path) -> list[Path]:
    """Return the files that `write_schemas` writes."""
    return [*_list_schemas(folder)]


def _list_schemas(folder: Path) -> dict[Path, Callable[[], Schema]]:
    """Return what makes the schema of each file."""
    printed = [document for document in list_documents() if "--json`" in document.about]
    return {
        **{folder / f"{kind}.schema.json": partial(file_schema, kind) for kind in KINDS},
        **{
            folder / f"output-{heading_anchor(document.title)}.schema.json": partial(output_schema, document)
            for document in printed
        },
    }


def output_schema(document: Document) -> Schema:
    """Return the JSON Schema of what a command prints: a document, or an array of them."""
    anchored = {heading_anchor(each.title): each for each in list_documents()}
    name, definitions = heading_anchor(document.title), dict[str, Schema]()
    wanted = [name]
    while wanted:
        if (anchor := wanted.pop()) not in definitions:
            definitions[anchor] = _table(anchored[anchor], anchored)
            wanted += re.findall(r'"#/\$defs/([\w-]+)"', json.dumps(definitions[anchor]))
    one = {"$ref": f"#/$defs/{name}"}
    head = {"$schema": _DIALECT, "title": f"gustproof: {document.title}", "description": document.about}
    return {**head, "anyOf": [one, {"type": "array", "items": one}], "$defs": definitions}


def _table(document: Document, anchored: dict[str, Document]) -> Schema:
    """Return the schema of the fields of a document; those of a linked one are a reference."""
    root: Schema = {"type": "object", "additionalProperties": False}
    for name, meaning in document.fields.items():
        links = _LINK.findall(meaning)
        if name == "<figure>":  # at the level of the document itself
            root.setdefault("properties", {}).update(_table(anchored[links[0]], anchored)["properties"])
            continue
        node = root
        for part in name.split("."):
            node.setdefault("type", ["object", "null"])
            node = _child(node, part)
        node["description"] = _LINK.sub("", meaning).replace("[", "", len(links))
        if document.types.get(name):
            node["type"] = [document.types[name], "null"]
        if links:
            linked = [{"$ref": f"#/$defs/{anchor}"} for anchor in links]
            node["anyOf"] = [*linked, {"type": "array", "items": {"anyOf": linked}}, {"type": [*_SCALARS]}]
    return root


_SCALARS = ("string", "number", "boolean", "null")


def _child(node: Schema, part: str) -> Schema:
    """Return the schema below another one of a part of a path, which is made; of an array's entries."""
    name, is_array = part.removesuffix("[]"), part.endswith("[]")
    others = node.setdefault("additionalProperties", False)
    if _ANY.fullmatch(name):
        child: Schema = others or {}
        node["additionalProperties"] = child
    elif _ANY.search(name):
        names = ".+".join(map(re.escape, _ANY.split(name)))
        child = node.setdefault("patternProperties", {}).setdefault(f"^{names}$", {})
    else:
        child = node.setdefault("properties", {}).setdefault(name, {})
    if is_array:
        child = child.setdefault("items", {})
    return child
