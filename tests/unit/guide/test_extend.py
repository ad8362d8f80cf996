"""The recipes of the guide, followed to the letter on a copy of the packages, by the real command line."""

import os
import re
import shutil
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PAGE = (files("gustproof.guide") / "extend.md").read_text(encoding="utf-8")
RECIPES = dict(re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", PAGE, flags=re.MULTILINE | re.DOTALL))
CALM = 'description = "calm"\nduration_s = 0.1\n'


def block(recipe: str, language: str) -> str:
    (found,) = re.findall(rf"^```{language}\n(.*?)^```", RECIPES[recipe], flags=re.MULTILINE | re.DOTALL)
    return found


def apply(recipe: str, root: Path) -> list[str]:
    """Follow the blocks of a recipe, and return the files that it makes or changes."""
    touched = []
    for name, text in re.findall(r"^```diff\n--- (\S+)\n(.*?)^```", RECIPES[recipe], flags=re.MULTILINE | re.DOTALL):
        path = root / name
        for hunk in re.split(r"^@@\n", text, flags=re.MULTILINE):
            lines = hunk.splitlines(keepends=True)
            before = "".join(line[1:] for line in lines if line.startswith(" "))
            after = "".join(line[1:] for line in lines)
            old = path.read_text(encoding="utf-8") if path.exists() else ""
            assert old.count(before) == 1 if before else not old, f"{name}: not once there: {before}"
            path.write_text(old.replace(before, after) if before else after, encoding="utf-8")
        touched.append(name)
    return touched


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Return a function that runs `gustproof` of a copy of the packages, not compiled, in the folder of the test."""
    for name in ("src/gustproof", "firmware_model"):
        shutil.copytree(ROOT / name, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    paths = f"{tmp_path / 'src'}{os.pathsep}{tmp_path}"
    own = {**os.environ, "PYTHONPATH": paths, "NUMBA_DISABLE_JIT": "1"}

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "gustproof", *words]
        return subprocess.run(command, env=own, check=False, capture_output=True, text=True, timeout=100.0)

    return run


def test_a_kind_of_wind_is_two_files(run, tmp_path):
    (tmp_path / "saw.toml").write_text(block("A kind of wind", "toml"), encoding="utf-8")
    refused = run("scenario", "check", "saw.toml")
    assert refused.returncode == 2
    assert len(apply("A kind of wind", tmp_path)) == 2
    told = run("fly", "saw.toml", "--law", "hinf-d1", "-o", "out")
    assert told.returncode == 0, told.stderr
    assert float(re.findall(r"peak, roll\D+([\d.]+)", told.stdout)[0]) > 0.3


def test_a_column_of_the_report_is_two_files(run, tmp_path):
    (tmp_path / "calm.toml").write_text(CALM, encoding="utf-8")
    assert len(apply("A column of the report", tmp_path)) == 2
    told = run("fly", "calm.toml", "--law", "hinf-d1", "-o", "out")
    assert told.returncode == 0, told.stderr
    assert float(re.findall(r"torque peak over rms\D+([\d.]+)", told.stdout)[0]) > 1.0


def test_a_law_structure_is_one_file_and_one_line(run, tmp_path):
    new, registry = apply("A law structure", tmp_path)
    assert not (ROOT / new).exists()
    added = len((tmp_path / registry).read_text().splitlines()) - len((ROOT / registry).read_text().splitlines())
    assert added == 1
    told = run("tune", "iris", "--law", "pd", "--json")
    assert told.returncode == 0, told.stderr
    assert '"kind": "pd"' in told.stdout


def test_a_log_format_is_one_file_and_two_lines(run, tmp_path):
    rows = "".join(f"{4000 * k} {0.1 * (k % 7)} 0 0\n" for k in range(500))
    (tmp_path / "flight.rates").write_text(f"RATES1\n{rows}", encoding="utf-8")
    assert "no flight log that is known" in run("identify", "log", "flight.rates").stderr
    assert len(apply("A log format", tmp_path)) == 2
    told = run("identify", "log", "flight.rates")
    assert "neither torque commands nor motor outputs are logged" in told.stderr  # read: it lacks the rest


def test_a_controller_is_no_file_of_ours(run, tmp_path):
    assert apply("A controller", tmp_path) == []
    (tmp_path / "hold.py").write_text(block("A controller", "python"), encoding="utf-8")
    (tmp_path / "calm.toml").write_text(CALM, encoding="utf-8")
    told = run("fly", "calm.toml", "--controller", "hold.py:make", "-o", "out")
    assert told.returncode == 0, told.stderr
