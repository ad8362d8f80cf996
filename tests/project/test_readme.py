"""The README is short, its example runs, and its figures are those of the pages that they come from."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
MOST_LINES = 150


def test_the_readme_is_short() -> None:
    assert len(README.splitlines()) <= MOST_LINES


@pytest.mark.compiled
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
    page = page.partition("## Their loops as laws")[0]
    rows = re.findall(
        r"^\| (PX4|ArduPilot), (tuned|`flagship` inside) \| (\.\d+) \| (\.\d+) \| ([\d.]+) \|", page, re.M
    )
    flown = {(autopilot, which): figures for autopilot, which, *figures in rows}
    assert len(flown) == 4
    text = " ".join(README.split())
    for autopilot in ("PX4", "ArduPilot"):
        tuned, inside = flown[autopilot, "tuned"], flown[autopilot, "`flagship` inside"]
        assert f"| error {inside[0]}° with our law inside, {tuned[0]}° with its own loops" in text
        assert f"{inside[1]}° and {tuned[1]}°" in text
    inner, own = ([flown[name, which][2] for name in ("PX4", "ArduPilot")] for which in ("`flagship` inside", "tuned"))
    assert f"torque slews of {inner[0]} and {inner[1]} N m/s, against {own[0]} and {own[1]} of the tuned" in text
