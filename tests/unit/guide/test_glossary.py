"""The glossary is short, plain, and about words that the code base uses."""

import re
from importlib.resources import files
from pathlib import Path

import pytest

import firmware_model
import gustproof

GLOSSARY = (files("gustproof.guide") / "glossary.md").read_text(encoding="utf-8")
ENTRIES = dict(re.findall(r"^- \*\*(.+?)\*\*[^:\n]*: (.+?)(?=\n\n|\n- |\Z)", GLOSSARY, flags=re.MULTILINE | re.DOTALL))
PACKAGES = [Path(package.__file__).parent for package in (firmware_model, gustproof)]
SOURCE = "\n".join(path.read_text(encoding="utf-8") for folder in PACKAGES for path in folder.rglob("*.py")).lower()
MOST_ENTRIES, MOST_WORDS = 40, 28


def test_every_line_of_the_list_is_an_entry_and_they_are_few() -> None:
    assert len(ENTRIES) == len(re.findall(r"^- ", GLOSSARY, flags=re.MULTILINE))
    assert len(ENTRIES) <= MOST_ENTRIES


@pytest.mark.parametrize("term", ENTRIES)
def test_term_is_used_in_the_code_base(term: str) -> None:
    words = r"[\s_-]+".join(re.escape(word) for word in re.split(r"[\s-]", term.lower()))
    assert re.search(rf"(?<![a-z]){words}", SOURCE), f"{term}: no source uses it"


@pytest.mark.parametrize("term", ENTRIES)
def test_entry_is_one_or_two_short_sentences(term: str) -> None:
    sentences = re.split(r"(?<=[.!?])\s+(?=[A-Z])", ENTRIES[term])
    assert len(sentences) <= 2
    assert max(len(sentence.split()) for sentence in sentences) <= MOST_WORDS
