"""The glossary is short, plain, and about words that the code base uses."""

import re
from importlib.resources import files
from pathlib import Path

import pytest

import firmware_model
import gustproof
from gustproof.guide.site import list_terms

GLOSSARY = (files("gustproof.guide") / "glossary.md").read_text(encoding="utf-8")
ENTRIES = list_terms(GLOSSARY)
PACKAGES = [Path(package.__file__).parent for package in (firmware_model, gustproof)]
SOURCE = "\n".join(path.read_text(encoding="utf-8") for folder in PACKAGES for path in folder.rglob("*.py")).lower()
MOST_ENTRIES, MOST_WORDS = 40, 28
PAGES = [Path(__file__).parents[3] / "README.md", *sorted(Path(str(files("gustproof.guide"))).rglob("*.md"))]
KNOWN = """
BSD CHANGELOG COMPleib CSV DuckDB FTP GPL GPS HIFOO HTML II III JAX JSBSim JSON LGPL LICENSE LPVTools MATLAB MB MIT OSI
OSQP PDF PGF PNG PSF PX4 README ROS SQLite SVG TCP TOML UAV UDP ULog macOS MAVProxy MAVSDK QGroundControl
ANGLE ATTITUDE BRAKE HEARTBEAT HOLD LAND STABILIZED
"""
"""Abbreviations that need no explanation: names of formats, licences, protocols, programs, plants, modes, messages."""
EXPLAINED = {
    "NED": "north, east, down (NED",
    "ENU": "east, north, up (ENU)",
    "IQC": "integral quadratic constraints",
    "LPV": "linear parameter-varying",
    "MCAP": "one MCAP file of ROS 2 messages",
    "PID": "proportional, integral and derivative",
    "STATUSTEXT": "the line of text that a pilot sees",
}
"""Abbreviations that a page explains where it uses them, with a part of the explanation."""


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


def test_every_abbreviation_is_explained() -> None:
    texts = {path.name: path.read_text(encoding="utf-8") for path in PAGES}
    everything = " ".join(" ".join(texts.values()).split())
    assert [word for word, part in EXPLAINED.items() if part not in everything] == []
    for name, text in texts.items():
        prose = re.sub(r"```.*?```|`[^`]*`|\]\([^)]*\)", "", text, flags=re.DOTALL)
        words = set(re.findall(r"\b[A-Za-z]*[A-Z]{2,}[A-Za-z0-9]*\b", prose)) - set(KNOWN.split()) - set(EXPLAINED)
        assert [word for word in sorted(words) if not re.search(rf"\b{word}\b", GLOSSARY)] == [], name
