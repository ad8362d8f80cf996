"""Lines of a TOML file where its keys stand, for errors."""

import re
from collections.abc import Iterator, Sequence

_HEADER = re.compile(r"\s*(\[\[?)\s*([^\]]+?)\s*\]")
_KEY = re.compile(r"""\s*([\w"'-][\w"'. -]*?)\s*=""")
_Key = tuple[int | str, ...]


def find_line(text: str, key: Sequence[int | str]) -> int | None:
    """Return the line, from 1 on, of a key in a sound TOML text; `None` if neither it nor its table is found.

    Tables of an array count from 0, as in `("wind", 0, "speed_mps")`. Parts that no key has, such as the kind of a
    table, are passed over. A key that is missing has the line of its table.
    """
    lines = dict(_list_keys(text))
    known = {place[:end] for place in lines for end in range(len(place) + 1)}
    place: _Key = ()
    for part in key:
        if (*place, part) in known:
            place = (*place, part)
    return next((lines[place[:end]] for end in range(len(place), 0, -1) if place[:end] in lines), None)


def _list_keys(text: str) -> Iterator[tuple[_Key, int]]:
    """Yield each table and each key with its line."""
    table: _Key = ()
    tables: dict[_Key, int] = {}  # of each array, the number of its last one
    inside = False  # a text of several lines
    for number, line in enumerate(text.splitlines(), 1):
        quotes = line.count('"""') + line.count("'''")
        if not inside and (header := _HEADER.match(line)):
            table = _table(header[2], tables, many=header[1] == "[[")
            yield table, number
        elif not inside and (found := _KEY.match(line)):
            yield (*table, *_split(found[1])), number
        inside ^= bool(quotes % 2)


def _table(name: str, tables: dict[_Key, int], *, many: bool) -> _Key:
    """Return the place of the table that a header opens; `tables` counts those of each array."""
    place: _Key = ()
    parts = _split(name)
    for i, part in enumerate(parts):
        place = (*place, part)
        if many and i == len(parts) - 1:
            tables[place] = tables.get(place, -1) + 1
        if place in tables:
            place = (*place, tables[place])
    return place


def _split(name: str) -> list[str]:
    return [part.strip().strip("\"'") for part in name.split(".")]
