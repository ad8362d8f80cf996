"""Reference of JSON output: fields of the models that print it, with the meanings of their docstrings.

`json-fields.toml` has the meanings of fields that no docstring explains, and the documents that are no model.
"""

import ast
import inspect
import re
import textwrap
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from importlib import import_module
from importlib.resources import files
from inspect import formatannotation
from types import MappingProxyType
from typing import Any, NamedTuple

from gustproof.guide.reference import markdown_table
from gustproof.guide.schemas import attribute_docs

_FIELDS = "json-fields.toml"
_JSON_TYPES = {"float": "number", "int": "integer", "str": "string", "bool": "boolean"}


class Document(NamedTuple):
    """Output of a command with `--json`, or a part of it."""

    title: str
    """Heading of its table."""
    about: str
    """Commands that print it."""
    fields: Mapping[str, str]
    """Meaning of each field by its path; `[]` follows an array, `<axis>` stands for any name."""
    types: Mapping[str, str] = MappingProxyType({})
    """JSON's name of the type of each field that is one attribute of a model: `number`, `string`, ..."""


@cache
def list_documents() -> list[Document]:
    """Return all documents in the order of the reference."""
    text = (files("gustproof.guide") / _FIELDS).read_text(encoding="utf-8")
    return [
        Document(
            each["title"], each["about"], _merge(each.get("model"), each.get("fields", {})), _types(each.get("model"))
        )
        for each in tomllib.loads(text)["document"]
    ]


def json_fields() -> str:
    """Return the reference of what `--json` prints."""
    parts = [
        "# Fields of JSON output\n\nEvery command that reports has `--json`. It prints one document on standard "
        "output, and nothing else. Units stand at the end of the names: `_deg`, `_s`, `_nm`. Numbers that are not "
        "finite are `null`. In this list `[]` follows an array, and a name in angle brackets stands for any. "
        "`gustproof guide --schemas DIR` writes these tables as JSON Schemas.\n"
    ]
    for title, about, meanings, _ in list_documents():
        rows = [(f"`{name}`", meaning) for name, meaning in meanings.items()]
        parts.append(f"## {title}\n\n{about}\n\n{markdown_table(('field', 'meaning'), rows) if rows else ''}")
    return "\n".join(parts)


def _merge(model: str | None, noted: Mapping[str, str]) -> dict[str, str]:
    """Return the fields of a model, then those that are only `noted`; a note goes before a docstring."""
    if model is None:
        return dict(noted)
    found = {key: _in_json(key, meaning) for key, meaning in _model_fields(_load(model))}
    return {**found, **noted}


def _load(model: str) -> type:
    module, _, name = model.rpartition(".")
    kind: type = getattr(import_module(module), name)
    return kind


def _types(model: str | None) -> dict[str, str]:
    """Return JSON's type of each field that a model writes as its attribute is."""
    if model is None:
        return {}
    kind = _load(model)
    hints = {
        name: hint for base in reversed(kind.__mro__) for name, hint in vars(base).get("__annotations__", {}).items()
    }
    named = {
        name: re.sub(r" \| None$", "", hint if isinstance(hint, str) else formatannotation(hint))
        for name, hint in hints.items()
    }
    keys = dict(_written_keys(vars(kind)["to_dict"])) if "to_dict" in vars(kind) else {}
    written = {key: source.removeprefix("self.") for key, source in keys.items()} or {name: name for name in named}
    return {key: _JSON_TYPES[named[name]] for key, name in written.items() if named.get(name) in _JSON_TYPES}


def _in_json(key: str, meaning: str) -> str:
    """Return a docstring in the words of JSON: `null`, and degrees for a field that is converted to them."""
    meaning = meaning.replace("`None`", "`null`").replace("NaN", "`null`")
    return meaning.replace("[rad]", "[deg]") if key.endswith("_deg") else meaning


def _model_fields(kind: type) -> Iterator[tuple[str, str]]:
    """Yield the fields of a model's JSON: the keys of its `to_dict`, or its attributes where that names none."""
    keys = list(_written_keys(vars(kind)["to_dict"])) if "to_dict" in vars(kind) else []
    if keys:
        yield from ((name, _attribute_meaning(kind, source, name)) for name, source in keys)
        return
    names = [field.name for field in fields(kind)] if is_dataclass(kind) else list(getattr(kind, "_fields", ()))
    docs = attribute_docs(kind)
    yield from ((name, docs.get(name, "")) for name in names)


def _written_keys(method: Callable[..., Any]) -> Iterator[tuple[str, str]]:
    """Yield the keys of the outermost dictionaries in a method's source, each with the source of its value."""
    nodes = list(ast.walk(ast.parse(textwrap.dedent(inspect.getsource(method)))))
    written = [node for node in nodes if isinstance(node, ast.Dict)]
    inner = {child for node in written for value in node.values for child in ast.walk(value)}
    for node in (node for node in written if node not in inner):
        for key, value in zip(node.keys, node.values, strict=True):
            if isinstance(key, ast.Constant):
                yield str(key.value), ast.unparse(value)


def _attribute_meaning(kind: type, source: str, key: str) -> str:
    """Return the docstring of the attribute that a field is made from, if it is the field's own."""
    found = re.search(r"self\.(\w+)(?!\.)\b", source)
    name = found[1] if found else ""
    return attribute_docs(kind).get(name, "") if name and key.startswith(name) else ""
