"""The action of `.github`: its last step, run by bash, with the command of this checkout."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).parents[2]
ACTION = ROOT / ".github" / "actions" / "compare" / "action.yml"
SHORT = 'description = "gusts"\nduration_s = 4.0\n\n[[wind]]\nkind = "dryden"\nwind_speed_20ft_mps = 15.0\n'


def run_step(folder: Path, **inputs: str) -> tuple[int, str]:
    """Return exit status and summary of the action's last step with inputs, and its defaults for the others."""
    document = YAML(typ="safe").load(ACTION.read_text(encoding="utf-8"))
    step = document["runs"]["steps"][-1]
    given = {name: inputs.get(name, each.get("default", "")) for name, each in document["inputs"].items()}
    told = {key: given[value.split("inputs.")[1].removesuffix(" }}")] for key, value in step["env"].items()}
    (folder / "gustproof").write_text(f'#!/bin/sh\nexec {sys.executable} -m gustproof "$@"\n')
    (folder / "gustproof").chmod(0o755)
    summary = folder / "summary.md"
    places = {"RUNNER_TEMP": str(folder), "GITHUB_STEP_SUMMARY": str(summary), "GITHUB_OUTPUT": str(folder / "outputs")}
    path = f"{folder}{os.pathsep}{os.environ['PATH']}"
    bash = shutil.which("bash")
    assert bash is not None
    done = subprocess.run(
        [bash, "--noprofile", "--norc", "-eo", "pipefail", "-c", step["run"]],
        cwd=folder, env={**os.environ, **told, **places, "PATH": path}, capture_output=True, check=False,
    )  # fmt: skip
    return done.returncode, summary.read_text(encoding="utf-8") if summary.exists() else ""


@pytest.mark.slow
def test_a_worse_law_fails_the_job_and_its_summary_has_the_table(tmp_path: Path) -> None:
    (tmp_path / "short.toml").write_text(SHORT)
    status, summary = run_step(tmp_path, laws="flagship\npid-fair\n\n", scenario="short.toml", runs="8")
    assert status == 1
    assert "| pid-fair |" in summary
    assert "worse" in summary
    assert "<failure" in (tmp_path / "gustproof.xml").read_text()
    assert (tmp_path / "outputs").read_text().splitlines()[1] == f"junit={tmp_path / 'gustproof.xml'}"


def test_a_wrong_law_fails_the_job_without_a_table(tmp_path: Path) -> None:
    assert run_step(tmp_path, laws="flagship\nnowhere.params") == (2, "")
