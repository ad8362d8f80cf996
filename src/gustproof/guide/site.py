"""Render the guide as a static site: HTML pages, one style sheet and pictures, which need no network.

Pages are Markdown, and so read well where they lie. Those of the reference are made from the models when the site is.
"""

import html
import re
import shutil
from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from itertools import count, pairwise
from pathlib import Path
from typing import NamedTuple

from markdown_it import MarkdownIt
from markdown_it.token import Token

from gustproof.guide import reference
from gustproof.version import __version__

GUIDE = Path(str(files("gustproof.guide")))

SECTIONS: Mapping[str, tuple[str, ...]] = {
    "Start": ("index", "install", "tutorial"),
    "How to": (
        "vehicle",
        "log",
        "scenario",
        "prove",
        "campaign",
        "league",
        "export",
        "ground-station",
        "px4",
        "ardupilot",
        "autopilots",
        "outside",
        "controllers",
        "protocol",
        "library",
        "matlab",
    ),
    "Background": ("laws", "vehicles", "theory", "limits", "glossary"),
    "Reference": (
        "commands",
        "options",
        "keys-scenario",
        "keys-vehicle",
        "keys-design",
        "keys-law",
        "json",
        "topics",
        "messages",
        "api",
    ),
}
"""Pages in the order of the contents, by section."""
MADE: Mapping[str, Callable[[], str]] = {
    "keys-scenario": reference.scenario_keys,
    "keys-vehicle": reference.vehicle_keys,
    "keys-design": reference.design_keys,
    "keys-law": reference.law_keys,
    "json": reference.json_fields,
    "topics": reference.bag_topics,
    "messages": reference.mavlink_messages,
    "api": reference.python_api,
}
"""Pages made from the models; `options` is made from the command line that is given."""


_WIDE = '<div class="wide" role="region" aria-label="Table {}" tabindex="0"><table>'
"""Opening of a table, which scrolls on its own if it is wide."""


class Page(NamedTuple):
    """One page of the guide."""

    name: str
    """Name of its file, without ending."""
    title: str
    """Its first heading."""
    markdown: str
    """Text."""


def page_names() -> list[str]:
    """Return the names of all pages in the order of the contents; what is neither made nor a file is left out."""
    names = [name for names in SECTIONS.values() for name in names]
    return [name for name in names if name in {*MADE, "options"} or (GUIDE / f"{name}.md").is_file()]


def load_pages(options: str) -> list[Page]:
    """Return all pages in the order of the contents; `options` is the Markdown of the command line's reference."""
    found = []
    for name in page_names():
        if name == "options":
            text = options
        else:
            text = MADE[name]() if name in MADE else (GUIDE / f"{name}.md").read_text(encoding="utf-8")
        found.append(Page(name, text.partition("\n")[0].removeprefix("# "), text))
    return found


def write_site(pages: Sequence[Page], folder: Path) -> None:
    """Write the site of the pages to a folder, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    for kind in ("pictures", "assets"):
        for file in sorted((GUIDE / kind).iterdir()):
            if file.suffix in {".png", ".svg", ".css"}:
                shutil.copyfile(file, folder / file.name)
    for page in pages:
        (folder / f"{page.name}.html").write_text(render_page(page, pages), encoding="utf-8")


def render_page(page: Page, pages: Sequence[Page]) -> str:
    """Return the HTML of a page with the contents of all."""
    body = render_markdown(page.markdown)
    place = pages.index(page)
    links = [
        f'<a rel="{relation}" href="{other.name}.html">{sign.format(html.escape(other.title))}</a>'
        for relation, other, sign in (
            ("prev", pages[place - 1] if place else None, "← {}"),
            ("next", pages[place + 1] if place + 1 < len(pages) else None, "{} →"),
        )
        if other
    ]
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{html.escape(page.title)} – gustproof</title>
<link rel="icon" href="data:,">
<link rel="stylesheet" href="guide.css">
</head>
<body>
<a class="skip" href="#main">Skip to the text</a>
<header><a href="index.html">gustproof</a> <span>{html.escape(__version__)}</span>
<a class="contents" href="#contents">Contents</a></header>
<main id="main" tabindex="-1">
{body}</main>
<nav id="contents" aria-label="Contents">
{_render_contents(page, pages)}</nav>
<footer><nav aria-label="Previous and next page">{"".join(links)}</nav></footer>
</body>
</html>
"""


def _render_contents(current: Page, pages: Sequence[Page]) -> str:
    titles = {page.name: page.title for page in pages}
    parts = []
    for section, names in SECTIONS.items():
        marks = dict.fromkeys(names, "") | {current.name: ' aria-current="page"'}
        entries = [
            f'<li><a href="{name}.html"{marks[name]}>{html.escape(titles[name])}</a></li>'
            for name in names
            if name in titles
        ]
        parts.append(f"<p>{section}</p><ul>{''.join(entries)}</ul>")
    return "\n".join(parts)


def render_markdown(text: str) -> str:
    """Return Markdown with tables as HTML: headings have anchors, links lead to pages, wide blocks can be scrolled."""
    parser = MarkdownIt("commonmark", {"html": False}).enable("table")
    tokens = parser.parse(text)
    _name_headings(tokens)
    for inline in (child for token in tokens for child in (token.children or ())):
        for key in ("href", "src"):
            if target := inline.attrGet(key):
                inline.attrSet(key, _site_address(str(target)))
    page = str(parser.renderer.render(tokens, parser.options, {}))
    numbers = count(1)
    page = re.sub("<table>", lambda _: _WIDE.format(next(numbers)), page)
    page = page.replace("</table>", "</table></div>").replace("<th>", '<th scope="col">')
    return page.replace("<pre>", '<pre tabindex="0">')


def _name_headings(tokens: Sequence[Token]) -> None:
    """Give each heading an anchor as GitHub does, so that links hold in both places."""
    seen: dict[str, int] = {}
    for opening, inline in pairwise(tokens):
        if opening.type == "heading_open":
            anchor = heading_anchor(inline.content)
            seen[anchor] = seen.get(anchor, -1) + 1
            opening.attrSet("id", anchor if not seen[anchor] else f"{anchor}-{seen[anchor]}")


def heading_anchor(heading: str) -> str:
    """Return the anchor of a heading: lower case, hyphens for spaces, without punctuation."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-")


def _site_address(target: str) -> str:
    """Return an address of the Markdown as one of the site: a page of the guide, or a file beside it."""
    file, mark, anchor = target.partition("#")
    if "://" in file or not file:
        return target
    if file.startswith("pictures/"):
        return file.removeprefix("pictures/")
    return f"{file.removesuffix('.md')}.html{mark}{anchor}" if file.endswith(".md") else target
