"""One rule for what is written: new, in a folder that exists, whole; --force overwrites a file."""

import shlex
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from gustproof.cli.app import app

FILES = """
tune paper -o there.json
tune paper --from px4 -o there.params
tune paper --figure there.png
tune paper --figure new.png --data
analyse flagship -o there.png
analyse flagship -o new.png --data
design hinfsyn D1 -o there.json
design hinfsyn D1 -o new.json
design hinfsyn D1 --figure there.png
design h2syn D2 -o there.json
design hinfstruct D2 3 -o there.json
design ncfsyn D2 -o there.json
design musyn D2 --angle-rad 0.1 --rate-rad-s 0.5 -o there.json
design lpv D2 --angle-rad 0.1 --rate-rad-s 0.5 -o there.json
certify gain hinf-d2 --angle-rad 0.1 --rate-rad-s 0.5 -o there.json
certify box flagship --horizon 60 -o there.json
certify air flagship paper-turbulence -o there.json
wind-limit iris -o there.html
worst-case flagship -o there.toml
worst-case flagship -o new.toml
worst-case flagship -o other.toml --shrink
judge px4 -o there.html
judge px4 --better there.params
judge flagship --better there.json
report run -o there.html
report run -o there.json
identify log log.ulg -o there.toml
identify log log.ulg --report there.html
identify log log.ulg --wind there.csv
identify log log.ulg --scenario there.toml
identify rates --connect 127.0.0.1:1 -o there.toml
scenario extract run -o there.csv
campaign fly gust-roll -o there.csv -o new.parquet
campaign fly gust-roll -o there.tex -o new.parquet
campaign fly gust-roll -o there.xml -o new.parquet
report run -o there.ulg
campaign rare gust-roll 'peak_deg > 1' -o there.toml
compare gust-roll --law flagship --law pid-fair -o there.md
export flagship -o there.c
export flagship -o new.c
export flagship -o there.mat
export flagship -o there.json
export flagship -o there
export flagship --px4 there
export flagship --ardupilot there
export flagship --crazyflie there
guide -o there --no-open
guide --schemas there
guide --examples there
""".strip().splitlines()
FOLDERS = (
    *(f"fly calm -o there{ending}" for ending in ("", ".json", ".xml", ".ulg")),
    "reproduce -o there",
)
PRECIOUS = (
    *(
        f"there.{suffix}"
        for suffix in ("json", "params", "png", "html", "toml", "csv", "tex", "c", "mat", "md", "xml", "ulg")
    ),
    *("new.csv", "new.png", "new.h", "new-vehicle.toml", "other-smallest.toml"),
    *("there/index.html", "there/scenario.schema.json", "there/01-first-gust.ipynb"),
)


def run(command: str):
    return CliRunner().invoke(app, shlex.split(command))


@pytest.fixture(autouse=True)
def _among_precious_files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in PRECIOUS:
        Path(name).parent.mkdir(exist_ok=True)
        Path(name).write_text("precious")
    yield
    assert {name: Path(name).read_text() for name in PRECIOUS} == dict.fromkeys(PRECIOUS, "precious")
    assert sorted(str(path) for path in Path().rglob("*") if path.is_file()) == sorted(PRECIOUS)


@pytest.mark.parametrize("command", FILES)
def test_a_file_that_exists_is_refused_before_any_work(command):
    result = run(command)
    assert result.exit_code == 2
    assert result.stderr.splitlines()[-1].endswith(": exists already; --force overwrites it")


@pytest.mark.parametrize("command", FOLDERS)
def test_a_recording_is_never_overwritten(command):
    result = run(command)
    assert (result.exit_code, len(result.stderr.splitlines())) == (2, 1)
    assert "nothing is overwritten" in result.stderr


@pytest.mark.parametrize("command", [*FILES, *FOLDERS])
def test_a_folder_that_is_missing_is_named_not_made(command):
    words = [f"no/such/{word}" if word.split(".")[0] in {"there", "new", "other"} else word for word in command.split()]
    result = run(" ".join(words))
    assert result.exit_code == 2
    assert result.stderr.splitlines()[-1] == "gustproof: no/such: no such folder"
    assert not Path("no").exists()


@pytest.mark.parametrize("path", ["there.json", "there"])
def test_a_folder_in_the_place_of_a_file_is_refused(path):
    Path("dir.json").mkdir()
    for force in ("", " --force"):
        result = run(f"tune paper -o dir.json{force}")
        assert (result.exit_code, result.stderr) == (2, "gustproof: dir.json: is a folder\n")
    Path("dir.json").rmdir()


def test_every_command_that_writes_files_has_the_one_option():
    found = set(_commands_with_force(typer.main.get_command(app)))
    writing = {name: [line for line in FILES if f"{line} ".startswith(f"{name} ")] for name in found}
    assert not [name for name, lines in writing.items() if not lines]
    assert {line for lines in writing.values() for line in lines} == set(FILES)
    assert not found & {"fly", "reproduce", "autopilot"}  # new folders and logs of flights alone


def _commands_with_force(command, *above):
    for name, each in getattr(command, "commands", {}).items():
        if any("--force" in parameter.opts for parameter in each.params):
            yield " ".join((*above, name))
        yield from _commands_with_force(each, *above, name)


def test_force_overwrites_files_and_holds_for_one_command_alone():
    Path("again.json").write_text("old")
    assert run("export flagship -o again.json --force").exit_code == 0
    assert "flagship" in Path("again.json").read_text()
    assert run("export flagship -o again.json").exit_code == 2
    Path("again.json").unlink()
