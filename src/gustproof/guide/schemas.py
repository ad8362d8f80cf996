"""JSON Schemas of the TOML files, with the meaning of each key: for editors, and for the reference.

Keys, types, ranges and defaults are those of the models that read the files; meanings are the models' docstrings.
"""

import ast
import inspect
import json
import sys
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from firmware_model.config.scenario import Scenario
from firmware_model.config.spreads import Spread
from firmware_model.config.vehicle import Vehicle
from gustproof.design.designs import Design
from gustproof.design.inner_loops import InnerLoops

Schema = dict[str, Any]
KINDS: Mapping[str, type] = {"scenario": Scenario, "vehicle": Vehicle, "design": Design, "loops": InnerLoops}
"""Model of each kind of file."""


def attribute_docs(kind: type) -> Mapping[str, str]:
    """Return the docstrings of a class's attributes and properties by name, those of its bases included."""
    docs: dict[str, str] = {}
    for base in reversed(kind.__mro__[:-1]):
        docs |= _body_docs(_class_body(base))
    return docs


def _class_body(kind: type) -> list[ast.stmt]:
    """Return the statements of a class; none of one that is built in."""
    found = _module_classes(kind.__module__).get(kind.__qualname__)
    if found is None and "<locals>" in kind.__qualname__:
        found = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
    return found.body if isinstance(found, ast.ClassDef) else []


@cache
def _module_classes(name: str) -> dict[str, ast.stmt]:
    """Return the classes of a module by name; none without a source."""
    try:
        tree = ast.parse(inspect.getsource(sys.modules[name]))
    except (OSError, TypeError):  # built in
        return {}
    return {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}


def _body_docs(body: list[ast.stmt]) -> dict[str, str]:
    """Return the docstrings of what the statements of a class define: each stands after its attribute."""
    docs = {}
    for item, after in pairwise([*body, ast.Pass()]):
        if isinstance(item, ast.FunctionDef):
            docs[item.name] = ast.get_docstring(item) or ""
        elif isinstance(item, ast.AnnAssign) and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            docs[ast.unparse(item.target)] = inspect.cleandoc(str(after.value.value))
    return {name: text for name, text in docs.items() if text}


class _WithMeanings(GenerateJsonSchema):
    """Schemas of dataclasses, with docstrings as descriptions."""

    def dataclass_schema(self, schema: core_schema.DataclassSchema) -> JsonSchemaValue:
        """Return the schema of a dataclass."""
        made = super().dataclass_schema(schema)
        docs = attribute_docs(schema["cls"])
        made["description"] = inspect.cleandoc(schema["cls"].__doc__ or "").partition("\n")[0]
        for name, field in made.get("properties", {}).items():
            field.pop("title", None)
            if name in docs:
                field["description"] = " ".join(docs[name].split())
        return made


def file_schema(kind: str) -> Schema:
    """Return the JSON Schema of a kind of file, one of `KINDS`.

    A schema allows no key or value that the models refuse, but for rules between keys, which only a load checks.
    """
    schema: Schema = TypeAdapter(KINDS[kind]).json_schema(schema_generator=_WithMeanings, mode="validation")
    tables = [schema, *schema.get("$defs", {}).values()]
    for table in tables:
        required = [key for key in table.get("required", ()) if not (table is schema and key == "name")]
        table["required"] = [key for key in required if key not in {"rows"}]  # read from the table's file
    if kind in _COMPLETE:
        _COMPLETE[kind](schema)
    title = f"gustproof {kind}"
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": title}


def _allow_spreads(schema: Schema) -> None:
    """Allow a spread in place of each number of a vehicle."""
    spread = TypeAdapter(Spread).json_schema(schema_generator=_WithMeanings)
    for table in [schema, *schema["$defs"].values()]:
        table["properties"] = {key: _or_spread(value) for key, value in table.get("properties", {}).items()}
    schema["$defs"]["Spread"] = spread


def _or_spread(value: Any) -> Any:
    if isinstance(value, list):
        return [_or_spread(item) for item in value]
    if not isinstance(value, dict):
        return value
    if value.get("type") in {"number", "integer"}:
        about = {key: value[key] for key in ("description", "default") if key in value}
        number = {key: item for key, item in value.items() if key not in about}
        return {"anyOf": [number, {"$ref": "#/$defs/Spread"}], **about}
    return {key: _or_spread(item) if key in {"anyOf", "prefixItems", "items"} else item for key, item in value.items()}


def _allow_constant_weights(schema: Schema) -> None:
    """Allow a list, the same gain at each frequency, in place of each weight of a design."""
    low = schema["$defs"]["Weight"]["properties"]["low"]
    gains = {key: value for key, value in low.items() if key != "description"}
    schema["$defs"]["WeightTable"] = schema["$defs"]["Weight"]
    schema["$defs"]["Weight"] = {"anyOf": [gains, {"$ref": "#/$defs/WeightTable"}]}


_COMPLETE: Mapping[str, Callable[[Schema], None]] = {"vehicle": _allow_spreads, "design": _allow_constant_weights}


@dataclass(frozen=True, kw_only=True)
class Key:
    """One key of a table, in words."""

    name: str
    """Key."""
    values: str
    """Type, with range and unit of count."""
    default: str
    """Default as Markdown; empty if the key must be given."""
    meaning: str
    """Unit and meaning."""


def describe_keys(table: Schema) -> list[Key]:
    """Return the keys of a table of a schema, in the order of the model."""
    required = set(table.get("required", ()))
    return [
        Key(
            name=name,
            values=describe_values(field),
            default="" if name in required else _default(field),
            meaning=field.get("description", ""),
        )
        for name, field in table.get("properties", {}).items()
    ]


def _default(field: Schema) -> str:
    value = field.get("default")
    if value is None or isinstance(value, dict):
        return "none" if value is None and "default" in field else "may be left out"
    return f"`{json.dumps(value, ensure_ascii=False)}`"


def describe_values(field: Schema) -> str:
    """Return the allowed values of a key, in words; tables by the name of their model in brackets."""
    if "const" in field:
        return json.dumps(field["const"])
    if "enum" in field:
        return ", ".join(json.dumps(value) for value in field["enum"])
    if "$ref" in field:
        return f"[{field['$ref'].rpartition('/')[2]}]"
    for key in ("anyOf", "oneOf"):
        if key in field:
            kinds = [describe_values(each) for each in field[key] if each.get("type") != "null"]
            return " or ".join(dict.fromkeys(kinds)) if len(kinds) < 5 else ", ".join(dict.fromkeys(kinds))
    if field.get("type") == "array":
        return _describe_list(field)
    return f"{field.get('type', 'value').replace('string', 'text')}{_describe_range(field)}"


def _describe_list(field: Schema) -> str:
    if "prefixItems" in field:
        return f"list of {len(field['prefixItems'])}: {describe_values(field['prefixItems'][0])}"
    least, most = field.get("minItems"), field.get("maxItems")
    count = f" of {least} to {most}" if least is not None and most is not None else ""
    return f"list{count}: {describe_values(field.get('items', {}))}"


def _describe_range(field: Schema) -> str:
    signs = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
    bounds = [f"{sign} {field[key]:g}" for key, sign in signs.items() if key in field]
    return f" {', '.join(bounds)}" if bounds else ""
