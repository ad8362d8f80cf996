"""Pages and tables as HTML."""

import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files

_NUMBER = re.compile(r"[≤≥<+−-]?[\d.]+(e[+-]?\d+)?$|–$|∞$")
"""Text of a cell that is a number, or stands for one."""


def escape_code(text: str) -> str:
    """Return a line of text as HTML; what stands between backticks is code."""
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(text))


def read_asset(name: str) -> str:
    """Return the text of a shipped part of a page."""
    return (files("gustproof.show.report") / "assets" / name).read_text(encoding="utf-8")


def fill_page(template: str, parts: Mapping[str, str]) -> str:
    """Return the page of `template` between the head and the foot of all pages, with its `parts` filled in.

    The parts of charts bring their scripts.
    """
    names = ["head.html", template, "foot.html", *(["charts.html"] if "scripts" in parts else [])]
    page = "".join(map(read_asset, names)) + "</body>\n</html>\n"
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], page)


def render_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of HTML cells, which scrolls sideways if it is wide; empty without rows.

    Columns of numbers are set to the right.
    """
    lines = [*rows]
    if not lines:
        return ""
    columns = zip(head, *lines, strict=True)
    right = [" class='num'" * all(map(_NUMBER.match, filter(None, column))) for _, *column in columns]
    right[0] = ""
    top = "".join(
        f'<th{side} scope="col">{cell}</th>' if cell else "<td></td>" for cell, side in zip(head, right, strict=True)
    )
    body = ""
    for row in lines:
        cells = "".join(f"<td{side}>{cell}</td>" for cell, side in zip(row[1:], right[1:], strict=True))
        first = f'<th scope="row">{row[0]}</th>' if row[0] else "<td></td>"
        body += f"<tr>{first}{cells}</tr>"
    return f'<div class="wide" tabindex="0"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def shorten(names: Iterable[str], most: int = 3) -> str:
    """Return names for a title: the first ones, and the number of the others."""
    first = [*names]
    rest = [f"{len(first) - most} more"] if len(first) > most + 1 else []
    return ", ".join([*first[:most], *rest] if rest else first)


def render_tiles(tiles: Iterable[tuple[str, Iterable[str]]]) -> str:
    """Return headline figures: heading as HTML, and lines by `render_tile_line`."""
    boxes = (f'<div class="tile"><h3>{heading}</h3><ul>{"".join(lines)}</ul></div>' for heading, lines in tiles)
    return f'<div class="tiles">{"".join(boxes)}</div>'


def render_tile_line(i: int, label: str, value: str, beside: str = "", *, is_best: bool = False) -> str:
    """Return a line of a tile: a name with its colour, a value, and a remark beside it."""
    mark = " class='best'" if is_best else ""
    return f"<li{mark}>{render_chip(i, label)}<b>{escape(value)}</b><small>{escape(beside)}</small></li>"


def render_chip(i: int, label: str) -> str:
    """Return a label beside the colour of its curves."""
    return f'<span class="name"><i class="chip" style="{chip_style(i)}"></i>{escape(label)}</span>'


def chip_style(i: int) -> str:
    """Return the style that gives an element the colour of curves number `i`."""
    return f"--chip: var(--c{i % 7})"


def render_list(lines: Sequence[str]) -> str:
    """Return lines of text as a list; nothing without any."""
    return f"<ul>{''.join(f'<li>{escape_code(line)}</li>' for line in lines)}</ul>" if lines else ""
