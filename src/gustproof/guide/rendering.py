"""Markdown as HTML: headings with anchors, tables that scroll, code in colours, and the text of each section."""

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import accumulate, count, pairwise
from typing import NamedTuple

from markdown_it import MarkdownIt
from markdown_it.token import Token
from pygments import highlight
from pygments.formatters import HtmlFormatter
from pygments.lexers import get_lexer_by_name

COLOURED = {"bibtex", "c", "console", "js", "json", "python", "toml"}
"""Languages of blocks of code that are shown in colours."""
_WIDE = '<div class="wide" role="region" aria-label="Table {}" tabindex="0"><table>'
"""Opening of a table, which scrolls on its own if it is wide."""

_ANCHORED = r'\1<a class="anchor" href="#\2" aria-hidden="true" tabindex="-1">#</a>\3'
"""Heading with a link to itself, for the mouse; the keyboard has the list of sections."""


class Section(NamedTuple):
    """Part of a page below one heading."""

    level: int
    """1 for the title of the page, 2 for its parts."""
    anchor: str
    """Its `id` on the page."""
    title: str
    """Heading, without marks."""
    text: str
    """All that is written until the next heading, without marks."""


def render_markdown(text: str, terms: Mapping[str, str] | None = None) -> tuple[str, list[Section]]:
    """Return Markdown with tables as HTML, and the sections that it has.

    Headings have anchors, links lead to pages of the site, wide blocks can be scrolled. The first use of each of the
    `terms`, with their meanings, leads to the glossary.
    """
    parser = MarkdownIt("commonmark", {"html": False, "highlight": _colour}).enable("table")
    tokens = parser.parse(text)
    _name_headings(tokens)
    _link_terms(tokens, dict(terms or {}))
    for inline in (child for token in tokens for child in (token.children or ())):
        for key in ("href", "src"):
            if target := inline.attrGet(key):
                inline.attrSet(key, _site_address(str(target)))
    page = str(parser.renderer.render(tokens, parser.options, {}))
    numbers = count(1)
    page = re.sub("<table>", lambda _: _WIDE.format(next(numbers)), page)
    page = page.replace("</table>", "</table></div>").replace("<th>", '<th scope="col">')
    page = re.sub(r'(<h[2-4] id="([^"]+)">.*?)(</h)', _ANCHORED, page)
    page = re.sub(r'<img src="([^"]+)"[^>]*>', r'<a href="\1" title="Enlarge the picture">\g<0></a>', page)
    return page.replace("<pre>", '<pre tabindex="0">'), list(_list_sections(tokens))


def _colour(code: str, language: str, _attributes: str) -> str:
    """Return a block of code as HTML with the classes of Pygments; without any if the language is not `COLOURED`."""
    if language not in COLOURED:
        return ""
    return str(highlight(code, get_lexer_by_name(language, stripnl=False), HtmlFormatter(nowrap=True)))


def _name_headings(tokens: Sequence[Token]) -> None:
    """Give each heading an anchor as GitHub does, so that links hold in both places."""
    seen: dict[str, int] = {}
    for opening, inline in pairwise(tokens):
        if opening.type == "heading_open":
            anchor = heading_anchor(inline.content)
            seen[anchor] = seen.get(anchor, -1) + 1
            opening.attrSet("id", anchor if not seen[anchor] else f"{anchor}-{seen[anchor]}")


def _link_terms(tokens: Sequence[Token], unseen: dict[str, str]) -> None:
    """Lead the first use of each unseen term in a paragraph or a list to the glossary, its meaning as a hint."""
    for before, token in pairwise(tokens):
        if before.type == "paragraph_open" and token.children:
            inside = accumulate(child.nesting if child.tag in {"a", "em"} else 0 for child in token.children)
            token.children = [
                part
                for child, depth in zip(token.children, inside, strict=True)
                for part in ([child] if depth or child.type != "text" else _split_at_terms(child.content, unseen))
            ]


def _split_at_terms(text: str, unseen: dict[str, str]) -> Iterator[Token]:
    """Yield the text as tokens, with links at terms, which are then no longer unseen."""
    while unseen and (found := re.search(rf"\b({'|'.join(map(re.escape, unseen))})\b(?!-)", text)):
        link = Token("link_open", "a", 1)
        link.attrs = {"href": f"glossary.md#{term_anchor(found[1])}", "class": "term", "title": unseen.pop(found[1])}
        yield from (_text(text[: found.start()]), link, _text(found[1]), Token("link_close", "a", -1))
        text = text[found.end() :]
    yield _text(text)


def _text(content: str) -> Token:
    return Token("text", "", 0, content=content)


def term_anchor(term: str) -> str:
    """Return the anchor of a term in the glossary."""
    return f"term-{heading_anchor(term)}"


def heading_anchor(heading: str) -> str:
    """Return the anchor of a heading: lower case, hyphens for spaces, without punctuation."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-")


def _list_sections(tokens: Sequence[Token]) -> Iterator[Section]:
    heading, words = Section(1, "", "", ""), list[str]()
    for before, token in pairwise([Token("", "", 0), *tokens]):
        if token.type == "heading_open":
            yield from [heading._replace(text=" ".join(words))] if heading.title else []
            words = []
        elif before.type == "heading_open":
            heading = Section(int(before.tag[1]), str(before.attrGet("id")), _plain(token), "")
        elif token.type in {"inline", "fence"}:
            words.append(" ".join(_plain(token).split()))
    yield heading._replace(text=" ".join(words))


def _plain(token: Token) -> str:
    """Return the text of an inline token or of a block of code, without marks."""
    return "".join(child.content or " " for child in token.children) if token.children else token.content


def _site_address(target: str) -> str:
    """Return an address of the Markdown as one of the site: a page of the guide, or a file beside it."""
    file, mark, anchor = target.partition("#")
    if "://" in file or not file:
        return target
    if file.startswith("pictures/"):
        return file.removeprefix("pictures/")
    return f"{file.removesuffix('.md')}.html{mark}{anchor}" if file.endswith(".md") else target
