"""The README is short, its example runs, and its figures are those of the pages that they come from."""

import re
from pathlib import Path

import pytest

from gustproof.guide.drawings import OWN_AND_INSIDE

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
MOST_LINES = 150
BY_VERSION = (
    r"^\| (PX4|ArduCopter)[ ,][^|]*\| [^|]*\| (\.\d+), (\.\d+) \| (\.\d+), (\.\d+) \| [^|]*\| [^|]*\| [^|]* \|$"
)
EQUAL_SLEWS = 0.01
ROUNDED = 2.0  # per cent of a ratio of errors with three digits after the point
"""[-] largest relative distance of slews that the README calls equal."""


def test_it_leads_to_every_page_of_the_guide() -> None:
    pages = set(
        re.findall(r"\]\((\w[\w-]*\.md)\)", (ROOT / "src/gustproof/guide/index.md").read_text(encoding="utf-8"))
    )
    assert pages - set(re.findall(r"guide/([\w-]+\.md)", README)) == {"options.md"}  # made with the guide


def test_the_readme_is_short() -> None:
    assert len(README.splitlines()) <= MOST_LINES


def test_the_example_runs_as_it_stands(capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = re.findall(r"^```python\n(.*?)^```", README, flags=re.MULTILINE | re.DOTALL)
    assert len(example.splitlines()) <= 10
    exec(compile(example, "README.md", "exec"), {})
    printed = capsys.readouterr().out
    errors = {name: float(value) for name, value in re.findall(r"^([\w-]+): RMSE ([\d.]+) deg", printed, re.M)}
    assert list(errors) == ["pid-default", "pid-fair", "flagship"]
    assert errors["flagship"] < errors["pid-fair"] < 0.2 < errors["pid-default"]


def test_figures_of_real_autopilots_are_those_of_their_page() -> None:
    page = (ROOT / "src" / "gustproof" / "guide" / "autopilots.md").read_text(encoding="utf-8")
    rows = re.findall(OWN_AND_INSIDE, page, re.M)
    flown = {(autopilot, which): [float(each) for each in figures] for autopilot, which, *figures in rows}
    assert len(flown) == len(rows) == 4
    text, gains = " ".join(README.split()), list[str]()
    for autopilot in ("PX4", "ArduPilot"):
        own, inside = flown[autopilot, "own loops"], flown[autopilot, "`flagship` inside"]
        assert inside[2] == pytest.approx(own[2], rel=EQUAL_SLEWS)
        gains += [f"{100.0 * (1.0 - ours / theirs):.0f} %" for ours, theirs in zip(inside[:2], own[:2], strict=True)]
        errors = [f"{value:.3f}°".lstrip("0") for value in (*inside[:2], *own[:2])]
        assert f"°), {gains[-2]} flown ({errors[0]} for {errors[2]}) ²" in text
        assert f"{errors[1]} for {errors[3]}" in text.partition("By their own estimates that is ")[2]
        assert f"{inside[2]:g}" in text.partition("on the stand, at ")[2][:20]
    page = " ".join(page.split())
    assert f"our law has {gains[0]} less error than PX4's own loops and {gains[2]} less than ArduPilot's" in page
    assert f"By their own estimates it is {gains[1]} and {gains[3]}." in page


def test_gains_by_version_are_those_of_its_rows() -> None:
    page = (ROOT / "src" / "gustproof" / "guide" / "autopilots.md").read_text(encoding="utf-8")
    told = {"PX4": list[tuple[float, ...]](), "ArduCopter": list[tuple[float, ...]]()}
    for kind, *figures in re.findall(BY_VERSION, page, re.M):
        own, by_own, inside, by_inside = map(float, figures)
        told[kind].append((100.0 * (1.0 - inside / own), 100.0 * (1.0 - by_inside / by_own)))
    assert {kind: len(rows) for kind, rows in told.items()} == {"PX4": 3, "ArduCopter": 2}
    ranges = [(min(each), max(each)) for rows in told.values() for each in zip(*rows, strict=True)]
    page, text = " ".join(page.split()), " ".join(README.split())
    (told_ranges,) = re.findall(r"it is (\d+) to (\d+) % in PX4 and (\d+) to (\d+) % in ArduPilot", page)
    assert [float(each) for each in told_ranges] == pytest.approx([*ranges[0], *ranges[2]], abs=ROUNDED)
    assert "have {} to {} %, {} to {} %.".format(*told_ranges) in text
    (told_own,) = re.findall(r"By the own estimates that is (\d+) to (\d+) % and (\d+) %", page)
    assert [float(each) for each in told_own] == pytest.approx([*ranges[1], ranges[3][0]], abs=ROUNDED)
