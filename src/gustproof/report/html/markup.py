"""Pages and tables as HTML."""

import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files


def read_asset(name: str) -> str:
    """Return the text of a shipped part of a page."""
    return (files("gustproof.report") / "assets" / name).read_text(encoding="utf-8")


def fill_page(template: str, parts: Mapping[str, str]) -> str:
    """Return the page whose head is common to all pages and whose body is `template`, with its `parts` filled in."""
    page = read_asset("head.html") + read_asset(template)
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], page)


def render_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of HTML cells; a wide table scrolls sideways."""
    top = "".join(f'<th scope="col">{cell}</th>' for cell in head)
    body = "".join(
        f'<tr><th scope="row">{row[0]}</th>{"".join(f"<td>{cell}</td>" for cell in row[1:])}</tr>' for row in rows
    )
    return f'<div class="wide" tabindex="0"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def render_chip(i: int, label: str) -> str:
    """Return a label beside the colour of its curves."""
    return f'<span class="name"><i class="chip" style="--chip: var(--c{i % 7})"></i>{escape(label)}</span>'
