"""Text of validation errors: for each, in one line, the key, the given value and what is allowed."""

import argparse
import re
from collections.abc import Iterable, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, NoReturn, get_args, get_type_hints

_MAX_ERRORS = 20  # reported one by one
_MAX_LENGTH = 300  # characters of one
_UNKNOWN = {"unexpected_keyword_argument", "extra_forbidden"}
_MISSING = {"missing", "missing_argument"}


def printable(text: str, keep: str = "") -> str:
    """Return a text with Python escape sequences in place of unprintable characters, except those in `keep`.

    Unprintable are control characters such as ESC, marks of writing direction, and lone surrogates.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep else c.encode("unicode_escape").decode() for c in text)


def sanitize_line(text: str) -> str:
    """Return a text without control characters, truncated if it is long."""
    shown = printable(text[: _MAX_LENGTH + 1])
    return shown if len(shown) <= _MAX_LENGTH else shown[: _MAX_LENGTH - 3] + "..."


class Parser(argparse.ArgumentParser):
    """Argument parser that prints errors in printable characters only."""

    def error(self, message: str) -> NoReturn:
        """Print the error and exit with status 2."""
        super().error(printable(message))


def format_errors(kind: Any, errors: Sequence[Any]) -> str:
    """Return all errors that pydantic found in a document of `kind`, in one line."""
    return "; ".join(list_errors(kind, errors))


def list_errors(kind: Any, errors: Sequence[Any]) -> list[str]:
    """Return a line for each error that pydantic found in a document of `kind`; beyond 20 only their number."""
    more = [f"and {len(errors) - _MAX_ERRORS} more"] if len(errors) > _MAX_ERRORS else []
    return [*(sanitize_line(_format_error(kind, item)) for item in errors[:_MAX_ERRORS]), *more]


def _format_error(kind: Any, item: Any) -> str:
    key, context = ".".join(str(part) for part in item["loc"]) or "file", item.get("ctx", {})
    if item["type"] in _UNKNOWN:
        known = ", ".join(_known_keys(kind, item["loc"][:-1]))
        return f"{sanitize_line(key)}: unknown key{known and f', known are {known}'}"
    if item["type"] in _MISSING:
        return f"{key}: missing"
    if item["type"] == "union_tag_not_found":
        return f"{key}.kind: missing"
    if item["type"] == "union_tag_invalid":
        return f"{key}.kind: must be one of {context['expected_tags']} (given '{sanitize_line(context['tag'])}')"
    message = str(context["error"]) if item["type"] == "value_error" else _toml_wording(item["msg"])
    if not isinstance(item["input"], dict):
        return f"{key}: {message} (given {item['input']!r})"
    many = item["type"] == "tuple_type" and _is_many(kind, key)
    return f"{key}: there may be many: write [[{key}]]" if many else f"{key}: {message}"


def _is_many(kind: Any, key: str) -> bool:
    """Return whether a key of `kind` holds a list of any length."""
    return is_dataclass(kind) and get_args(get_type_hints(kind).get(key))[-1:] == (Ellipsis,)


def _toml_wording(message: str) -> str:
    """Return a message of pydantic with the type names of TOML in place of Python's."""
    message = re.sub(r"(valid )?dictionary or (an instance of \w+|object to extract fields from)", "table", message)
    return (message[:1].lower() + message[1:]).replace("tuple", "list")


def _known_keys(kind: Any, location: Iterable[int | str]) -> tuple[str, ...]:
    """Return the keys of the table at a location in a document of `kind`; none if it can't be followed."""
    for part in location:
        if isinstance(part, int):
            kind = next(iter(get_args(kind)), None)
        elif is_dataclass(kind):
            kind = get_type_hints(kind).get(part)
        else:
            kind = next((one for one in get_args(kind) if part in get_args(get_type_hints(one).get("kind"))), None)
    return tuple(field.name for field in fields(kind)) if is_dataclass(kind) else ()
