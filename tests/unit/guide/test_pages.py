"""Every command, block of code and link on every page of the guide, and in the README, is what it says."""

import ast
import os
import re
import shlex
import tomllib
from functools import cache
from importlib.resources import files
from itertools import pairwise
from pathlib import Path

import pytest
import typer.main
from ruamel.yaml import YAML

from firmware_model.config.files import validate
from firmware_model.config.scenario import Scenario, list_scenarios
from firmware_model.config.vehicle import load_vehicle
from gustproof.cli.app import app
from gustproof.guide import site
from gustproof.guide.rendering import heading_anchor
from gustproof.law.form import list_laws
from gustproof.show.reproduce.errata import ERRATA

ROOT = Path(__file__).parents[3]
GUIDE = Path(str(files("gustproof.guide")))
PAGES = {"README": ROOT / "README.md", **{path.stem: path for path in sorted(GUIDE.glob("*.md"))}}
TEXTS = {name: path.read_text(encoding="utf-8") for name, path in PAGES.items()}
OTHER_PROGRAMS = {
    "source",
    "gcc",
    "mavproxy.py",
    "pip",
    "plotjuggler",
    "python",
    "python3",
    "tools/bench",
    "tools/demo",
    "tools/test",
}
LAW_FILES = (".json", ".mat", ".params", ".param")


def blocks(name: str, language: str) -> list[str]:
    """Return the blocks of code of a page in one language."""
    return re.findall(rf"^```{language}[^\n]*\n(.*?)^```", TEXTS[name], flags=re.MULTILINE | re.DOTALL)


def lines(name: str) -> list[list[str]]:
    """Return the words of each command in the console blocks of a page, those joined by && apart."""
    shown = "".join(blocks(name, "console")).replace("\\\n", " ").splitlines()
    assert all(line.startswith("$ ") for line in shown if line), f"{name}: a line of a console block without prompt"
    commands = [shlex.split(part, comments=True) for line in shown for part in line.removeprefix("$ ").split(" && ")]
    return [words for words in commands if words]


LINES = [(name, words) for name in TEXTS for words in lines(name)]
GUSTPROOF_LINES = sorted({tuple(words) for _, words in LINES if words[0] == "gustproof"})


@cache
def command_line():
    return typer.main.get_command(app)


@pytest.mark.slow
@pytest.mark.parametrize("words", GUSTPROOF_LINES, ids=" ".join)
def test_command_of_a_page_has_these_options_and_names(words: tuple[str, ...]) -> None:
    _, name, *arguments = words
    if name.startswith("-"):
        assert name in {option for parameter in command_line().params for option in parameter.opts}
        return
    command = command_line().commands[name]
    while hasattr(command, "commands"):
        if arguments and arguments[0] in command.commands:
            name, *arguments = arguments
        else:
            name = command.find_meant(arguments)
        command = command.commands[name]
    command.make_context(name, list(arguments))  # raises for an unknown option, a wrong type or too few arguments
    laws = [value for option, value in pairwise(arguments) if option == "--law"]
    assert all(law in list_laws() or law.endswith((*LAW_FILES, ":make")) for law in laws)
    if name in {"fly", "compare"}:
        assert arguments[0].endswith(".toml") or arguments[0] in [*list_scenarios(), "course"]


def test_every_other_program_of_the_pages_is_expected() -> None:
    others = {words[0] for _, words in LINES} - {"gustproof"}
    assert others == OTHER_PROGRAMS


def test_the_tools_that_the_readme_starts_are_there_and_executable() -> None:
    tools = {words[0] for name, words in LINES if name == "README" and words[0].startswith("tools/")}
    assert tools == {"tools/bench", "tools/demo", "tools/test"}
    assert all(os.access(ROOT / tool, os.X_OK) for tool in tools)


def test_the_page_of_commands_shows_every_command_with_its_purpose() -> None:
    commands = set(command_line().commands)
    assert {words[1] for words in lines("commands")} - {"--version", "--install-completion"} == commands
    assert set(re.findall(r"^\| `([\w-]+)` \|", TEXTS["commands"], flags=re.MULTILINE)) == commands


@pytest.mark.parametrize("name", TEXTS)
def test_blocks_of_python_and_toml_are_whole(name: str) -> None:
    for block in blocks(name, "python"):
        ast.parse(block)
    for block in blocks(name, "toml"):
        tomllib.loads(block)
    for block in blocks(name, "yaml"):
        YAML(typ="safe").load(block)
    known = {"python", "toml", "diff", "console", "c", "js", "yaml", "text", "bibtex"}
    assert set(re.findall(r"^```(\w+)", TEXTS[name], flags=re.MULTILINE)) <= known


def test_the_scenario_of_the_guide_is_sound() -> None:
    (block,) = blocks("scenario", "toml")
    day = validate(Scenario, {"name": "day", **tomllib.loads(block)}, "day.toml")
    assert (len(day.wind), len(day.event), len(day.link), len(day.require)) == (2, 1, 1, 1)
    assert f"shows {len(list_scenarios())} examples" in TEXTS["scenario"]


def test_the_vehicle_of_the_guide_is_sound(tmp_path: Path) -> None:
    (block,) = blocks("vehicle", "toml")
    (tmp_path / "my-quad.toml").write_text(block, encoding="utf-8")
    assert load_vehicle(tmp_path / "my-quad.toml").mass == 2.06


def test_the_page_of_laws_has_every_shipped_law() -> None:
    assert set(re.findall(r"^\| `([\w-]+)` \|", TEXTS["laws"], flags=re.MULTILINE)) == set(list_laws())


def test_the_errata_are_those_that_reproduce_prints() -> None:
    rows = re.findall(r"^\| (.+) \|$", TEXTS["theory"].replace("\\|", "¦"), flags=re.MULTILINE)[1:]
    assert rows == [f"{gap} | {choice}".replace("|θ|", "¦θ¦") for gap, choice in ERRATA]


@pytest.mark.parametrize("name", TEXTS)
def test_links_lead_to_files_and_headings(name: str) -> None:
    folder = PAGES[name].parent
    text = re.sub(r"^```.*?^```", "", TEXTS[name], flags=re.MULTILINE | re.DOTALL)
    for target in re.findall(r"\]\(\s*([^)\s]+)\s*\)", text):
        file, _, anchor = target.partition("#")
        if "://" in file:
            continue
        made = folder == GUIDE and file.removesuffix(".md") in {*site.MADE, "options"}
        assert made or not file or (folder / file).is_file(), f"{name}: no {file}"
        if anchor and not made:
            headings = re.findall(r"^#+ (.+)$", (folder / file).read_text() if file else text, flags=re.MULTILINE)
            assert anchor in map(heading_anchor, headings), f"{name}: no heading #{anchor}"


def test_every_page_is_in_the_contents_once() -> None:
    names = [name for names in site.SECTIONS.values() for name in names]
    assert len(names) == len(set(names))
    assert set(names) == {*TEXTS, *site.MADE, "options"} - {"README"}
