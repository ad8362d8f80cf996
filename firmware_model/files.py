"""Read a TOML file into a checked dataclass, every mistake reported at once in one clear line."""

import tomllib
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from firmware_model.errors import ConfigError

Parsed = TypeVar("Parsed")


def shipped(folder: Path) -> tuple[str, ...]:
    """Return the names of the files shipped in `folder`."""
    return tuple(sorted(path.stem for path in folder.glob("*.toml")))


def read_toml(kind: type[Parsed], name_or_path: str | Path, folder: Path) -> Parsed:
    """Read `name_or_path`, a file or the name of one shipped in `folder`, as a `kind`.

    Raises
    ------
    ConfigError
        If there is no such file, it is not TOML, or a key or value is not allowed.
    """
    path = Path(name_or_path)
    if path.suffix != ".toml":
        path = folder / f"{name_or_path}.toml"
        if str(name_or_path) not in shipped(folder):
            known = ", ".join(shipped(folder))
            raise ConfigError(f"no {kind.__name__.lower()} named '{name_or_path}': give a .toml file or one of {known}")
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not TOML: {error}") from None
    return parse(kind, {"name": path.stem, **document}, str(path))


def parse(kind: type[Parsed], document: dict[str, Any], source: str) -> Parsed:
    """Return `document` as a checked `kind`; `source` stands in front of each mistake."""
    try:
        return TypeAdapter(kind).validate_python(document)
    except ValidationError as error:
        raise ConfigError(f"{source}: " + "; ".join(_mistake(item) for item in error.errors())) from None


def _mistake(item: Any) -> str:
    key = ".".join(str(part) for part in item["loc"]) or "file"
    if item["type"] in {"unexpected_keyword_argument", "extra_forbidden"}:
        return f"{key}: unknown key"
    if item["type"] in {"missing", "missing_argument"}:
        return f"{key}: missing"
    shown = "" if isinstance(item["input"], dict) else f" (given {item['input']!r})"
    return f"{key}: {item['msg'][:1].lower()}{item['msg'][1:]}{shown}"
