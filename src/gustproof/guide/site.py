"""Render the guide as a static site: HTML pages, one style sheet and pictures, which need no network.

Pages are Markdown, and so read well where they lie. Those of the reference are made from the models when the site is.
"""

import html
import json
import re
from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

from firmware_model.config.whole_file import write_folder
from gustproof.guide import documents, reference
from gustproof.guide.rendering import Section, render_markdown, term_anchor
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
        "wind",
        "export",
        "figures",
        "viewers",
        "ground-station",
        "px4",
        "ardupilot",
        "autopilots",
        "outside",
        "controllers",
        "protocol",
        "library",
        "course",
        "matlab",
    ),
    "Background": ("laws", "vehicles", "theory", "limits", "glossary"),
    "Inside": ("built", "extend", "checker"),
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
    "json": documents.json_fields,
    "topics": reference.bag_topics,
    "messages": reference.mavlink_messages,
    "api": reference.python_api,
}
"""Pages made from the models; `options` is made from the command line that is given."""


_GLOSSARY = "glossary"


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
    """Write the site of the pages to a new folder, whole or not at all."""
    write_folder(folder, render_site(pages))


def render_site(pages: Sequence[Page]) -> dict[str, str | bytes]:
    """Return the contents of the site's files by name."""
    site: dict[str, str | bytes] = {}
    for kind in ("pictures", "assets"):
        for file in sorted((GUIDE / kind).iterdir()):
            if file.suffix in {".png", ".svg", ".css", ".js"}:
                site[file.name] = file.read_bytes()
    index = []
    terms = list_terms(next((page.markdown for page in pages if page.name == _GLOSSARY), ""))
    for page in pages:
        body, sections = render_markdown(page.markdown, {} if page.name == _GLOSSARY else terms)
        if page.name == _GLOSSARY:
            body = re.sub("<strong>(.+?)</strong>", lambda m: f'<strong id="{term_anchor(m[1])}">{m[1]}</strong>', body)
        site[f"{page.name}.html"] = _render_page(page, pages, body, sections)
        index += [(page.name, each.anchor, page.title, each.title, each.text) for each in sections]
    words = json.dumps(index, ensure_ascii=False, separators=(",", ":"))
    site["search.js"] = f"guideIndex({words});\n"
    return site


def list_terms(glossary: str) -> dict[str, str]:
    """Return the meaning of each term of the glossary, without marks."""
    found = re.findall(r"^- \*\*(.+?)\*\*[^:\n]*: (.+?)(?=\n\n|\n- |\Z)", glossary, re.MULTILINE | re.DOTALL)
    return {term: re.sub(r"[`*]", "", " ".join(meaning.split())) for term, meaning in found}


def _render_page(page: Page, pages: Sequence[Page], body: str, sections: Sequence[Section]) -> str:
    """Return the HTML of a page: its `body`, its `sections`, and the contents of all pages."""
    place = pages.index(page)
    links = [
        f'<a rel="{relation}" href="{other.name}.html">{sign.format(html.escape(other.title))}</a>'
        for relation, other, sign in (
            ("prev", pages[place - 1] if place else None, "← {}"),
            ("next", pages[place + 1] if place + 1 < len(pages) else None, "{} →"),
        )
        if other
    ]
    made = page.name in MADE or page.name == "options"
    source = "models, docstrings and commands" if made else f"<code>src/gustproof/guide/{page.name}.md</code>"
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{html.escape(page.title)} – gustproof</title>
<link rel="icon" href="data:,">
<link rel="stylesheet" href="guide.css">
<script src="guide.js" defer></script>
</head>
<body>
<a class="skip" href="#main">Skip to the text</a>
<header><a href="index.html">gustproof</a> <span>{html.escape(__version__)}</span>
<a class="contents" href="#contents">Contents</a>
<form role="search" hidden><input type="search" aria-label="Search the guide" placeholder="Search ( / )"
autocomplete="off" spellcheck="false"><ul aria-label="Found"></ul><p role="status"></p></form></header>
{_render_sections(sections)}<main id="main" tabindex="-1">
{body}</main>
<nav id="contents" aria-label="Contents">
{_render_contents(page, pages)}</nav>
<footer><nav aria-label="Previous and next page">{"".join(links)}</nav>
<p>Made from {source}</p></footer>
</body>
</html>
"""


def _render_sections(sections: Sequence[Section]) -> str:
    """Return the links to the sections of a page; nothing if it has fewer than three."""
    parts = [section for section in sections if section.level == 2]
    links = "".join(f'<li><a href="#{part.anchor}">{html.escape(part.title)}</a></li>' for part in parts)
    if len(parts) < 3:
        return ""
    listed = f"<details><summary>On this page</summary><ul>{links}</ul></details>"
    return f'<nav id="sections" aria-label="On this page">{listed}</nav>\n'


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
