"""Text of validation errors: for each, in one line, the key, the given value and what is allowed."""

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from typing import Any, get_args, get_type_hints

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


def did_you_mean(given: str, known: Iterable[str]) -> str:
    """Return a question that names the known word nearest to a mistyped one, after a semicolon; empty if none is near.

    Examples
    --------
    >>> did_you_mean("flagshp", ["flagship", "indi"])
    "; did you mean 'flagship'?"
    >>> did_you_mean("pid", ["indi", "pid-default", "pid-fair"])
    "; did you mean 'pid-fair'?"
    """
    words, asked = {word.lower(): word for word in known}, given.lower()[:_MAX_LENGTH]
    begun = [word for word in words if len(asked) > 1 and word.startswith(asked)]
    near = get_close_matches(asked, begun or words, n=1, cutoff=0.0 if begun else 0.5)
    return f"; did you mean '{words[near[0]]}'?" if near else ""


def none_of(given: str, known: Sequence[str]) -> str:
    """Return the words that refuse a name outside a list: all that are known, and the nearest."""
    return f"'{sanitize_line(given)}' is none of {', '.join(known)}{did_you_mean(given, known)}"


def format_errors(kind: Any, errors: Sequence[Any]) -> str:
    """Return all errors that pydantic found in a document of `kind`, in one line."""
    return "; ".join(list_errors(kind, errors))


def list_errors(
    kind: Any, errors: Sequence[Any], line_of: Callable[[Sequence[int | str]], int | None] = lambda _: None
) -> list[str]:
    """Return a line for each error that pydantic found in a document of `kind`; beyond 20 only their number.

    `line_of` gives the line of a file where a key stands, `None` if it is unknown.
    """
    more = [f"and {len(errors) - _MAX_ERRORS} more"] if len(errors) > _MAX_ERRORS else []
    shown = []
    for item in errors[:_MAX_ERRORS]:
        line = line_of(item["loc"]) if item["loc"] else None
        shown.append(sanitize_line(f"{'' if line is None else f'line {line}, '}{_format_error(kind, item)}"))
    return [*shown, *more]


def _format_error(kind: Any, item: Any) -> str:
    key, context = ".".join(str(part) for part in item["loc"]), item.get("ctx", {})
    if item["type"] in _UNKNOWN:
        known = _known_keys(kind, item["loc"][:-1])
        listed = f", known are {', '.join(known)}" if known else ""
        return f"{sanitize_line(key)}: unknown key{listed}{did_you_mean(str(item['loc'][-1]), known)}"
    if item["type"] in _MISSING:
        return f"{key}: missing"
    if item["type"] == "union_tag_not_found":
        return f"{key}.kind: missing"
    if item["type"] == "union_tag_invalid":
        tags, given = context["expected_tags"], context["tag"]
        near = did_you_mean(given, tags.replace("'", "").split(", "))
        return f"{key}.kind: must be one of {tags} (given '{sanitize_line(given)}'){near}"
    return _format_value(kind, key, item)


def _format_value(kind: Any, key: str, item: Any) -> str:
    """Return the error of a value that is not allowed; without `key` it is of a whole table, and names keys itself."""
    message = str(item["ctx"]["error"]) if item["type"] == "value_error" else _toml_wording(item["msg"])
    if isinstance(item["input"], float) and not math.isfinite(item["input"]):
        message = "must be a finite number"
    given = "" if not key or isinstance(item["input"], dict) else f" (given {item['input']!r})"
    many = not given and item["type"] == "tuple_type" and _is_many(kind, key)
    return f"{key}: there may be many: write [[{key}]]" if many else f"{key}{': ' if key else ''}{message}{given}"


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
