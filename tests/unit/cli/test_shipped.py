"""What is shipped is listed and shown in one way, completed by a shell, and a mistyped name has the nearest one."""

import json
import re
import tomllib

import pytest
from typer.testing import CliRunner

from firmware_model.config.scenario import list_scenarios
from firmware_model.config.vehicle import list_vehicles
from gustproof.cli.app import app
from gustproof.design.designs import list_designs
from gustproof.law.form import list_laws, load_law
from gustproof.version import __version__

NAMES = {"law": list_laws(), "vehicle": list_vehicles(), "design": list_designs(), "scenario": list_scenarios()}


def run(*arguments: str):
    return CliRunner().invoke(app, list(arguments))


@pytest.mark.parametrize("kind", NAMES)
def test_a_list_has_every_name_with_its_subject(kind: str):
    listed = json.loads(run(kind, "list", "--json").stdout)
    assert [each["name"] for each in listed] == list(NAMES[kind])
    assert all(len(each["description"]) > 20 for each in listed)
    shown = run(kind, "list").stdout
    assert all(name in shown for name in NAMES[kind])


@pytest.mark.parametrize("kind", ["vehicle", "design", "scenario"])
def test_what_is_shown_is_the_file_and_as_json_has_its_values(kind: str):
    name = NAMES[kind][0]
    shown, values = tomllib.loads(run(kind, "show", name).stdout), json.loads(run(kind, "show", name, "--json").stdout)
    assert values["name"] == name
    assert values["description"] == shown["description"]


def test_a_law_is_shown_by_its_facts_and_as_json_whole():
    shown = run("law", "show", "hinf-d1")
    assert "D1: closest to the paper" in shown.stdout
    assert "gustproof analyse hinf-d1" in shown.stdout
    assert json.loads(run("law", "show", "hinf-d1", "--json").stdout) == load_law("hinf-d1").to_dict()


@pytest.mark.parametrize("kind", NAMES)
def test_an_unknown_name_is_one_line_with_the_nearest(kind: str):
    name = NAMES[kind][0]
    result = run(kind, "show", f"{name}x")
    assert result.exit_code == 2
    assert result.stderr.strip().splitlines() == [
        f"gustproof: no {kind} named '{name}x'; did you mean '{name}'? Or give a "
        f"{'.json' if kind == 'law' else '.toml'} file, or a name that `gustproof {kind} list` shows"
    ]


def test_a_name_like_no_other_has_no_nearest():
    assert "no law named 'zzz': give a .json file" in run("law", "show", "zzz").stderr


@pytest.mark.parametrize(
    ("arguments", "nearest"),
    [
        (["desgn", "D1"], "design"),
        (["law", "shw"], "show"),
        (["fly", "papr", "--law", "hinf-d1"], "paper"),
        (["fly", "paper", "--law", "hinf-d1", "--vehicle", "irs"], "iris"),
        (["fly", "paper", "--autopilot", "px5"], "px4"),
        (["fly", "paper", "--lw", "hinf-d1"], "--law"),
        (["design", "hinfsy", "D1"], "hinfsyn"),
        (["campaign", "fly", "paper", "-o", "x.parquet", "--sampling", "sobl"], "sobol"),
        (["campaign", "fly", "paper", "-o", "x.parquet", "--spread", "gst"], "gust"),
    ],
)
def test_a_mistyped_word_has_the_nearest_known_one(arguments: list[str], nearest: str, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = run(*arguments)
    assert result.exit_code == 2
    said = " ".join(result.stderr.replace("│", " ").split())
    assert "Traceback" not in said
    assert f"id you mean '{nearest}'?" in said or re.search(rf"Possible options: .*{nearest}\b", said)


def test_the_first_command_of_a_group_needs_no_name():
    assert run("controller", "--law", "no-such").stderr == run("controller", "run", "--law", "no-such").stderr
    assert run("identify", "none.ulg").stderr == run("identify", "log", "none.ulg").stderr
    assert run("identify", "--connect=x", "-o", "y.toml").stderr.startswith("gustproof: --connect is 'x'")
    for name in ("autopilot", "controller", "design", "identify"):
        assert "Commands" in run(name, "--help").stdout


def test_the_version_is_one_line():
    assert run("--version").stdout == f"gustproof {__version__}\n"


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("gustproof vehi", "vehicle"),
        ("gustproof fly paper-", "paper-turbulence"),
        ("gustproof fly paper --law flag", "flagship"),
        ("gustproof controller --law flag", "flagship"),
        ("gustproof autopilot --he", "--held"),
        ("gustproof autopilot st", "stand"),
        ("gustproof identify ra", "rates"),
        ("gustproof design hinfsyn D", "D1"),
        ("gustproof design l", "list"),
        ("gustproof vehicle show i", "iris"),
        ("gustproof fly paper --vehicle oc", "octo"),
    ],
)
def test_a_shell_completes_commands_options_and_names(words: str, found: str, monkeypatch):
    monkeypatch.setenv("_GUSTPROOF_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
    result = CliRunner().invoke(app, [], prog_name="gustproof")
    assert found in result.stdout.split()


def test_help_tells_of_completion_and_where_to_start():
    shown = " ".join(run("--help").stdout.split())
    assert "--install-completion" in shown
    assert shown.index("─ Start") < shown.index(" doctor ") < shown.index("─ Your vehicle")
