"""The ways of the guide, walked as written in an empty folder, end with what they promise."""

import re
import shlex
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.cli.app import app
from gustproof.design import tune as tuning
from gustproof.flight.scoring.metrics import measure
from gustproof.guide.drawings import WORST_MOMENT, draw_pictures, fly_both, tilt_deg
from gustproof.law.form import load_law

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("_flown_here", "_few_points")]
GUIDE = Path(str(files("gustproof.guide")))


@pytest.fixture
def _few_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw the curves of `tune` through fewer points; the laws are the same."""
    monkeypatch.setattr(tuning, "_SLEWS", (0.5, 2.0))
    monkeypatch.setattr(tuning, "_PEAKS", (1.3, 1.6))


def commands(page: str) -> list[str]:
    """Return the commands of a page that need no program of others."""
    text = (GUIDE / f"{page}.md").read_text(encoding="utf-8")
    shown = re.findall(r"^```console\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    return [line.removeprefix("$ ") for line in "".join(shown).splitlines() if line]


def walk(lines: list[str], *, failing: tuple[str, ...] = ()) -> dict[str, str]:
    """Run commands in the present folder, and return what each prints; those `failing` exit with status 1."""
    told = {}
    for line in lines:
        program, *arguments = shlex.split(line)
        assert program == "gustproof"
        result = CliRunner().invoke(app, arguments)
        assert result.exit_code == (line in failing), f"{line}: {result.output}"
        told[line] = result.output
    return told


def is_begun_by(printed: str, shown: str) -> bool:
    """Return whether a printed line begins with a shown one, whose numbers may be 2 % off on another machine."""
    number = r"\d+\.?\d*"
    words = [re.sub(r" +", " ", re.sub(number, "#", each)).strip() for each in (printed, shown)]
    if not words[0].startswith(words[1]):
        return False
    values = [[float(value) for value in re.findall(number, each)] for each in (printed, shown)]
    return values[0][: len(values[1])] == pytest.approx(values[1], rel=0.02)


def test_the_tutorial_ends_with_every_file_that_it_promises(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    log_page = [line for line in commands("log") if "my-log" in line or "my-air" in line]
    steps = dict.fromkeys([*commands("tutorial"), *log_page])
    told = walk([*steps], failing=("gustproof fly gust-roll --law hinf-d1 --output paper",))
    page = (GUIDE / "tutorial.md").read_text(encoding="utf-8")
    promised = re.findall(r"`([\w.-]+)`", page.partition("## What you have now")[2].rpartition("|")[0])
    assert len(promised) >= 15
    assert [name for name in promised if not (tmp_path / name).exists()] == []
    shown = "".join(re.findall(r"^```text\n(.*?)^```", page, flags=re.MULTILINE | re.DOTALL)).splitlines()
    printed = "\n".join(told.values()).splitlines()
    assert len(shown) >= 20
    assert [line for line in shown if not any(is_begun_by(each, line) for each in printed)] == []
    peaks = [re.search(r"peak +│ ([\d.]+)", told[line]) for line in list(told)[:2]]
    assert [float(peak[1]) for peak in peaks if peak] == [pytest.approx(0.4, abs=0.05), pytest.approx(3.3, abs=0.05)]
    (identified,) = (text for line, text in told.items() if " identify " in line and " fly " not in line)
    assert "actuator lag [ms]" in identified
    proofs = [text for line, text in told.items() if " certify " in line]
    assert all(": proven" in text or "proven: " in text for text in proofs)
    assert len(proofs) == 2
    assert len(log_page) == 3  # so that page is walked too


def test_the_way_from_a_measured_inertia_to_c_runs_as_it_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    text = (GUIDE / "vehicle.md").read_text(encoding="utf-8")
    (file,) = re.findall(r"^```toml\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    (tmp_path / file.splitlines()[0].removeprefix("# ")).write_text(file, encoding="utf-8")
    told = {line.split()[1]: output for line, output in walk(commands("vehicle")).items()}
    assert list(told) == ["tune", "certify", "fly", "export"]
    (least,) = re.findall(r"alone: ([\d.]+) at this Ms and slew", told["tune"])
    figures = load_law("quad-law.json").provenance.parameters
    assert figures["foretold_slew_nm_per_s"] <= 6.9
    assert figures["foretold_rmse_deg"] <= 1.15 * float(least) <= 0.095
    (flown,) = re.findall(r"RMSE +│ ([\d.]+)", told["fly"])
    assert float(flown) <= 0.06
    assert ": proven\n" in told["certify"]
    assert "int aided_my_quad_step(" in (tmp_path / "quad-law.c").read_text()
    assert len(list((tmp_path / "quad-flight").rglob("*.mcap"))) == 1


def test_the_pictures_are_what_the_tool_draws_now(tmp_path: Path) -> None:
    drawn = draw_pictures(tmp_path / "pictures")
    shipped = {path.name: path for path in (GUIDE / "pictures").glob("*.png")}
    assert {path.name for path in drawn} == set(shipped)
    assert sum(path.stat().st_size for path in shipped.values()) < 220_000
    for path in drawn:
        assert compare_pictures(path, shipped[path.name]) < 0.01, path.name
    assert compare_pictures(drawn[0], drawn[2]) > 0.03


def compare_pictures(path: Path, other: Path) -> float:
    """Return the mean difference of two pictures' brightness, 1 for black beside white."""
    with Image.open(path) as drawn, Image.open(other) as shipped:
        pair = [np.asarray(each.convert("L").resize((450, 150)), dtype=float) for each in (drawn, shipped)]
    return float(np.abs(pair[0] - pair[1]).mean() / 255.0)


def test_the_readme_figures_beside_the_paper_are_flown() -> None:
    vehicle, readme = load_vehicle("paper"), (Path(__file__).parents[3] / "README.md").read_text(encoding="utf-8")
    flights = fly_both(load_scenario(WORST_MOMENT), vehicle)
    paper, ours = (float(tilt_deg(flights[law]).max()) for law in ("hinf-d1", "flagship"))
    assert f"tilt {ours:.0f}° instead of {paper:.0f}°" in readme
    assert "stays within 1° of level" in readme
    assert ours < 1.0
    scenario = load_scenario("paper-turbulence")
    flights = fly_both(scenario, vehicle)
    d1, flagship = (measure(flights[law], vehicle, scenario) for law in ("hinf-d1", "flagship"))
    assert f"error {flagship.rmse_deg:.2f}° instead of {d1.rmse_deg:.1f}°".replace(" 0.", " .") in readme
    assert f"slew {d1.torque_slew_rms:.1f} instead of {flagship.torque_slew_rms:.0f} N m/s" in readme


def test_the_moment_of_the_picture_is_within_the_budget_of_the_paper() -> None:
    moments = load_scenario(WORST_MOMENT).moment
    budget = (0.65, 0.65, 0.3)  # [N m], `gustproof worst-case --help`
    assert all(sum(abs(each.amplitude_nm[axis]) for each in moments) <= budget[axis] for axis in range(3))


@pytest.mark.parametrize(("page", "printed"), [("library", r"RMSE 0\.\d+ deg"), ("figures", r"\(2500,\) 0\.\d+")])
def test_an_example_of_python_runs_as_it_stands(
    page: str, printed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    page_text = (GUIDE / f"{page}.md").read_text(encoding="utf-8")
    for example in re.findall(r"^```python\n(.*?)^```", page_text, flags=re.MULTILINE | re.DOTALL):
        exec(compile(example, f"{page}.md", "exec"), {})
    assert re.search(printed, capsys.readouterr().out)
    assert (tmp_path / "mine.json").exists() == (page == "library")
