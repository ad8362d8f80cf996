"""Help that fits on a screen: options and lines of every command at 80 columns, in the order of the main road."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from firmware_model.config.vehicle import FullScale, MeasuredCommand, load_vehicle
from gustproof.cli.app import PANELS, app
from gustproof.cli.judge import _print_next
from gustproof.law.form import load_law
from gustproof.studies.rate import advice
from gustproof.studies.rate.judge import Verdict

MOST_OPTIONS, MOST_LINES = 12, 60
LONGER = {"fly": 16, "campaign fly": 16}
"""Commands with more options, and how many."""


def commands(command: Any = None, *path: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    command = command or typer.main.get_command(app)
    yield path, command
    for name, each in getattr(command, "commands", {}).items():
        yield from commands(each, *path, name)


@pytest.fixture(scope="module")
def helps() -> dict[str, list[str]]:
    run = CliRunner()
    wide = {"COLUMNS": "80", "TERMINAL_WIDTH": "80"}
    shown = {" ".join(path): run.invoke(app, [*path, "--help"], env=wide) for path, _ in commands()}
    assert {result.exit_code for result in shown.values()} == {0}
    return {name: result.stdout.rstrip().splitlines() for name, result in shown.items()}


def test_no_command_has_more_options_than_a_reader_holds() -> None:
    counts = {" ".join(path): sum(p.param_type_name == "option" for p in each.params) for path, each in commands()}
    assert {name: n for name, n in counts.items() if n > LONGER.get(name, MOST_OPTIONS)} == {}


@pytest.mark.slow
def test_no_help_is_longer_than_a_screen(helps: dict[str, list[str]]) -> None:
    assert {name: len(lines) for name, lines in helps.items() if len(lines) > MOST_LINES} == {}
    assert max(len(line) for lines in helps.values() for line in lines) <= 80


def test_the_first_help_has_the_main_road_on_top_and_a_line_for_each_command(helps: dict[str, list[str]]) -> None:
    found = [line.split()[1] for line in helps[""] if line.startswith(("╭─", "│ ")) and "--" not in line]
    names = [word for panel in PANELS for word in (panel.split()[0], *PANELS[panel])]
    assert [word for word in found if word in names] == names


def test_every_mode_of_a_group_is_told_by_its_help(helps: dict[str, list[str]]) -> None:
    for path, each in commands():
        for mode in getattr(each, "commands", {}):
            assert any(line.split()[1:2] == [mode] for line in helps[" ".join(path)]), (path, mode)


@pytest.mark.parametrize(
    ("kind", "gains", "verdict", "better", "words"),
    [
        (None, "my-law.json", Verdict.SOUND, None, "export my-law.json --vehicle q.toml --px4 my-law-px4"),
        (None, "a b.json", Verdict.FRAGILE, None, "judge 'a b.json' --vehicle q.toml --better 'a b-better.json'"),
        (None, "a.json", Verdict.SOUND, None, "export a.json -o a.c"),
        (None, "my-law.json", Verdict.FRAGILE, "b.json", "export b.json --vehicle q.toml --px4 b-px4"),
        (
            "px4",
            "my.params",
            Verdict.SOUND,
            None,
            "fly paper-turbulence --autopilot px4 --params my.params --vehicle q.toml",
        ),
        ("px4", "my.params", Verdict.FRAGILE, None, "judge my.params --vehicle q.toml --better my-better.params"),
        (
            "px4",
            "a.ulg",
            Verdict.FRAGILE,
            "b.params",
            "fly paper-turbulence --autopilot px4 --params b.params --vehicle q.toml",
        ),
        ("px4", "a.ulg", Verdict.SOUND, None, None),
    ],
)
def test_a_verdict_is_followed_by_the_command_that_leads_to_the_board(
    kind: str | None, gains: str, verdict: Verdict, better: str | None, words: str | None,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setattr(advice, "autopilot_kind", lambda _: kind)
    found: Any = SimpleNamespace(law=load_law("flagship"), verdict=verdict)
    tuned: Any = SimpleNamespace() if better or kind else None
    group: Any = typer.main.get_command(app)
    given = [gains, "--vehicle", "q.toml", *(["--better", better] if better else [])]
    context = group.commands["judge"].make_context("judge", given, parent=group.context_class(group))
    vehicle = load_vehicle("paper")
    if words == "export a.json -o a.c":  # a vehicle from a log that does not tell what a command gives
        vehicle = replace(vehicle, command=MeasuredCommand(autopilot="csv", full_scale=FullScale.UNKNOWN, delay=0.0))
    _print_next(context, found, tuned, vehicle, None if better is None else Path(better))
    assert capsys.readouterr().out == ("" if words is None else f"next: gustproof {words}\n")


@pytest.mark.parametrize("group", ["campaign", "certify", "design", "law", "scenario", "vehicle"])
def test_a_group_without_a_mode_shows_its_modes_and_does_nothing(group: str, helps: dict[str, list[str]]) -> None:
    result = CliRunner().invoke(app, [group], env={"COLUMNS": "80", "TERMINAL_WIDTH": "80"})
    assert result.exit_code == 2
    assert result.stdout.splitlines() == helps[group]
    assert not result.stderr


@pytest.mark.parametrize(
    ("word", "meant"), [("version", "--version"), ("help", "--help"), ("league", "compare course")]
)
def test_a_word_of_other_programs_or_of_before_is_told_what_is_meant(word: str, meant: str) -> None:
    result = CliRunner().invoke(app, [word])
    assert result.exit_code == 2
    assert f"No such command '{word}': say gustproof {meant}" in result.output


def test_an_option_for_what_is_done_in_any_case_is_told_so() -> None:
    result = CliRunner().invoke(app, ["doctor", "--autopilots"])
    assert result.exit_code == 2
    said = " ".join(result.output.replace("│", " ").split())  # in a box of any width
    assert "--autopilots; gustproof doctor finds them in any case" in said


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("certify flagship --moment 1,1,1", "box"),
        ("certify hinf-d2 --angle-rad 0.1", "gain"),
        ("certify box.json --law flagship", "check"),
        ("campaign gust-roll --runs 40", "fly"),
        ("autopilot stand --instance 3", "stand"),
    ],
)
def test_a_mode_that_is_not_named_is_found_by_the_options(given: str, meant: str) -> None:
    group, *words = given.split()
    found: Any = typer.main.get_command(app)
    assert found.commands[group].find_meant(words) == meant
    options_first = CliRunner().invoke(app, [group, *words[1:], "--nosuch"])
    assert "No such option: --nosuch" in options_first.output
    mistyped = CliRunner().invoke(app, [group, f"{meant}x", *words])
    assert f"'{meant}x' is none of " in mistyped.output
    assert f"did you mean '{meant}'?" in " ".join(mistyped.output.replace("│", " ").split())
