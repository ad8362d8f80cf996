"""The README's commands, options, laws and scenarios exist, and its examples run."""

import os
import re
import shlex
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from typer.testing import CliRunner

from firmware_model.config.scenario import list_scenarios, load_scenario
from gustproof.cli.app import app
from gustproof.law.form import list_laws, load_law

ROOT = Path(__file__).parents[2]


def console_lines() -> list[str]:
    """Return the lines typed in the README's console blocks, without prompt, continued lines joined."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```console\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    joined = "".join(blocks).replace("\\\n", " ")
    return [line.removeprefix("$ ") for line in joined.splitlines() if line.startswith("$ ")]


def words(line: str) -> list[str]:
    return shlex.split(line, comments=True)


def gustproof_lines() -> list[str]:
    return [line for line in console_lines() if line.startswith("gustproof ")]


@cache
def help_text(*command: str) -> str:
    """Return what `gustproof COMMAND --help` prints."""
    wide = {**os.environ, "COLUMNS": "250", "NO_COLOR": "1", "TERM": "dumb"}
    arguments = [sys.executable, "-m", "gustproof", *command, "--help"]
    return subprocess.run(arguments, capture_output=True, text=True, check=True, env=wide).stdout


def commands() -> set[str]:
    """Return the names of all commands, as they are typed."""
    names = [info.callback.__name__ for info in app.registered_commands if info.callback]
    return {name.replace("_", "-") for name in [*names, *groups()]}


def groups() -> set[str]:
    """Return the names of the commands that have commands of their own."""
    return {info.name for info in app.registered_groups if info.name}


@pytest.mark.parametrize("line", gustproof_lines())
def test_a_command_of_the_readme_has_these_options_and_names(line: str) -> None:
    _, command, *arguments = words(line)
    assert command in commands()
    shown = help_text(command, arguments[0]) if command in groups() else help_text(command)
    for argument in arguments:
        if argument.startswith("-"):
            option = re.escape(argument.partition("=")[0])
            assert re.search(rf"(?<![\w-]){option}(?![\w-])", shown), f"gustproof {command} has no option {argument}"
    if "--law" in arguments:
        law = arguments[arguments.index("--law") + 1]
        assert law.endswith(".json") or law in list_laws()
    if command == "fly" and "--repeat" not in arguments:
        assert arguments[0].endswith(".toml") or arguments[0] in list_scenarios()


def test_the_readme_shows_every_command() -> None:
    shown = {words(line)[1] for line in gustproof_lines()}
    assert shown == commands()


def test_the_tools_that_the_readme_starts_are_there_and_executable() -> None:
    tools = {words(line)[0] for line in console_lines() if line.startswith("tools/")}
    assert {"tools/demo", "tools/test"} <= tools
    assert all(os.access(ROOT / tool, os.X_OK) for tool in tools)


def test_the_library_example_runs_as_it_stands(tmp_path: Path) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"^```python\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    run = subprocess.run([sys.executable, "-c", example], capture_output=True, text=True, cwd=tmp_path, check=True)
    rmse = re.search(r"RMSE ([\d.]+) deg", run.stdout)
    assert rmse is not None
    assert 0.0 < float(rmse[1]) < 1.0
    assert (tmp_path / "mine.json").exists()


def section(title: str, language: str) -> list[str]:
    """Return the code of a section of the README, its blocks of one language."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (found,) = re.findall(rf"^## {title}\n(.*?)^## ", text, flags=re.MULTILINE | re.DOTALL)
    return re.findall(rf"^```{language}\n(.*?)^```", found, flags=re.MULTILINE | re.DOTALL)


def test_the_scenario_of_the_readme_is_sound(tmp_path: Path) -> None:
    (example,) = section("A gusty day of your own", "toml")
    (tmp_path / "day.toml").write_text(example)
    day = load_scenario(tmp_path / "day.toml")
    assert (len(day.wind), len(day.event), len(day.link), len(day.require)) == (2, 1, 1, 1)


def run_section(title: str) -> dict[str, str]:
    """Run the commands of a section in the present folder, and return what each prints by its name."""
    (commands,) = section(title, "console")
    told = {}
    for line in commands.splitlines():
        _, *arguments = words(line.removeprefix("$ "))
        result = CliRunner().invoke(app, arguments)
        assert result.exit_code == 0, f"{line}: {result.output}"
        told[arguments[0]] = result.output
    return told


@pytest.mark.compiled
def test_the_way_from_a_flight_log_to_its_twin_runs_as_it_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    told = run_section("From a flight log")
    assert list(told) == ["fly", "identify"]
    assert "actuator lag [ms]" in told["identify"]
    files = ("my-twin.toml", "my-twin.html", "my-wind.csv", "my-air.toml")
    assert all((tmp_path / name).is_file() for name in files)


@pytest.mark.compiled
def test_the_way_from_a_measured_inertia_to_c_runs_as_it_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for file in section("A vehicle of your own", "toml"):
        name = file.splitlines()[0].removeprefix("# ")
        (tmp_path / name).write_text(file, encoding="utf-8")
    told = run_section("A vehicle of your own")
    assert list(told) == ["tune", "certify", "fly", "export"]
    (least,) = re.findall(r"least: ([\d.]+) at this Ms and slew", told["tune"])
    figures = load_law("my-law.json").provenance.parameters
    assert figures["foretold_slew_nm_per_s"] <= 6.9
    assert figures["foretold_rmse_deg"] <= 1.15 * float(least) <= 0.095
    (flown,) = re.findall(r"RMSE +│ ([\d.]+)", told["fly"])
    assert float(flown) <= 0.06
    assert "proven: " in told["certify"]
    assert "int aided_my_quad_step(" in (tmp_path / "my-law.c").read_text()
    assert len(list((tmp_path / "my-flight").rglob("*.mcap"))) == 1
