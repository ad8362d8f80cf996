"""The JSON Schemas allow every shipped file, refuse wrong keys and values, and explain each key."""

import json
import math
import tomllib
from functools import cache
from pathlib import Path

import pytest

from firmware_model.config.scenario import SCENARIOS
from firmware_model.config.vehicle import VEHICLES
from gustproof.design.designs import DESIGNS
from gustproof.guide import schemas
from gustproof.guide.schema_files import write_schemas
from gustproof.guide.schemas import KINDS, attribute_docs, describe_keys

FILES = [
    *(("scenario", path) for path in sorted(SCENARIOS.glob("*.toml"))),
    *(("vehicle", path) for path in sorted(VEHICLES.glob("*.toml"))),
    *(("design", path) for path in sorted(DESIGNS.glob("*.toml"))),
]
TYPES = {"object": dict, "array": list, "string": str, "boolean": bool, "number": (int, float), "integer": int}


file_schema = cache(schemas.file_schema)


def faults(value, schema, root, place="file"):
    """Yield where a document breaks a schema; of JSON Schema, the part that the schemas here use."""
    if "$ref" in schema:
        schema = {**root["$defs"][schema["$ref"].rpartition("/")[2]], **schema}
    if "const" in schema and value != schema["const"]:
        yield f"{place}: not {schema['const']}"
    if "enum" in schema and value not in schema["enum"]:
        yield f"{place}: none of {schema['enum']}"
    for key in ("anyOf", "oneOf"):
        branches = schema.get(key)
        if branches and all(any(True for _ in faults(value, branch, root, place)) for branch in branches):
            yield f"{place}: fits nothing of {key}"
    kind = schema.get("type")
    if kind == "null":
        yield f"{place}: TOML has no null"
    elif kind and (not isinstance(value, TYPES[kind]) or (kind != "boolean" and isinstance(value, bool))):
        yield f"{place}: is no {kind}"
        return
    if isinstance(value, dict):
        known = schema.get("properties", {})
        yield from (f"{place}.{key}: missing" for key in schema.get("required", ()) if key not in value)
        for key, item in value.items():
            if key in known:
                yield from faults(item, known[key], root, f"{place}.{key}")
            elif schema.get("additionalProperties") is False:
                yield f"{place}.{key}: unknown"
    elif isinstance(value, list):
        if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", math.inf):
            yield f"{place}: {len(value)} items"
        kinds = schema.get("prefixItems") or [schema.get("items", {})] * len(value)
        for number, (item, each) in enumerate(zip(value, kinds, strict=False)):
            yield from faults(item, each, root, f"{place}.{number}")
    elif isinstance(value, int | float) and not isinstance(value, bool):
        low, above = schema.get("minimum", -math.inf), schema.get("exclusiveMinimum", -math.inf)
        high, below = schema.get("maximum", math.inf), schema.get("exclusiveMaximum", math.inf)
        if not (low <= value <= high and above < value < below):
            yield f"{place}: {value} is out of range"


@pytest.mark.parametrize(("kind", "path"), FILES, ids=lambda value: getattr(value, "stem", value))
def test_shipped_file_fits_its_schema(kind: str, path: Path) -> None:
    schema = file_schema(kind)
    assert list(faults(tomllib.loads(path.read_text(encoding="utf-8")), schema, schema)) == []


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        ("scenario", "description = 'd'\nduration_s = -1.0"),
        ("scenario", "duration_s = 1.0"),
        ("scenario", "description = 'd'\nduration_s = 1.0\ndurations_s = 2"),
        ("scenario", "description = 'd'\nduration_s = 1.0\n[[wind]]\nkind = 'drydn'"),
        ("scenario", "description = 'd'\nduration_s = 1.0\n[gyro]\nbias = 3"),
        ("design", "description = 'd'\nleak = 0.0"),
        ("vehicle", "mass = 1.0"),
        ("loops", "[roll]\nomega = 'fast'"),
    ],
)
def test_wrong_file_breaks_its_schema(kind: str, wrong: str) -> None:
    schema = file_schema(kind)
    assert list(faults(tomllib.loads(wrong), schema, schema))


@pytest.mark.parametrize("kind", KINDS)
def test_every_key_of_every_table_is_explained(kind: str) -> None:
    schema = file_schema(kind)
    tables = [schema, *(table for table in schema["$defs"].values() if "properties" in table)]
    assert [key.name for table in tables for key in describe_keys(table) if not key.meaning] == []


def test_schemas_are_written_with_a_name_for_each_kind(tmp_path: Path) -> None:
    written = write_schemas(tmp_path / "schemas")
    assert [path.name for path in written[: len(KINDS)]] == [f"{kind}.schema.json" for kind in KINDS]
    assert "output-a-flight.schema.json" in [path.name for path in written[len(KINDS) :]]
    assert json.loads(written[0].read_text(encoding="utf-8"))["$schema"].endswith("2020-12/schema")


def test_docstrings_of_attributes_are_found_with_those_of_bases() -> None:
    class Base:
        a: int = 0
        """First."""

    class Derived(Base):
        b: int = 0
        """Second."""

        @property
        def c(self) -> int:
            """Third."""
            return 0

    assert attribute_docs(Derived) == {"a": "First.", "b": "Second.", "c": "Third."}
