import sys

import pytest

from firmware_model.errors import ConfigError
from gustproof.flight.controllers.library import load_library
from gustproof.flight.controllers.stepper import make_stepper
from gustproof.flight.controllers.user_controller import (
    ControllerKind,
    confirm_controller,
    find_program,
    parse_controller,
    parse_controller_metadata,
)


@pytest.fixture
def file(tmp_path):
    made = tmp_path / "my_mpc.py"
    made.write_text("make = object\n")
    return made


def test_each_way_in_has_its_kind_name_and_digest(file, tmp_path, monkeypatch):
    library = tmp_path / "law.so"
    library.write_bytes(b"")
    monkeypatch.syspath_prepend(tmp_path)
    found = [parse_controller(each) for each in (f"{file}:make", "my_mpc:fast", str(library), "exec: node ./mine.mjs")]
    kinds = ControllerKind.PYTHON, ControllerKind.PYTHON, ControllerKind.LIBRARY, ControllerKind.PROGRAM
    assert tuple(entry.kind for entry in found) == kinds
    assert [entry.name for entry in found] == ["my_mpc", "my_mpc-fast", "law", "mine"]
    assert found[0].digest == found[1].digest != found[2].digest
    assert found[3].digest == ""


@pytest.mark.parametrize(
    ("source", "complaint"),
    [
        ("flagship", "is none of"),
        ("exec: ", "names no command"),
        ("nowhere.py:make", "No such file"),
        ("no_such_module:make", "no module named 'no_such_module'"),
        ("no_such.module:make", "No module named 'no_such'"),
        ("a b:make", "is none of"),
        ("./nowhere.so", "No such file"),
    ],
)
def test_what_names_no_entry_is_told(source, complaint):
    with pytest.raises(ConfigError, match=complaint):
        parse_controller(source)


def test_a_program_that_is_there_is_its_words_and_another_is_told():
    assert find_program("exec: sh -c 'exit 3'") == ["sh", "-c", "exit 3"]
    with pytest.raises(ConfigError, match="there is no program 'no-such-program'"):
        find_program("exec: no-such-program sh")


def test_a_flown_entry_flies_again_if_it_is_named_again_and_has_not_changed(file, tmp_path):
    flown = parse_controller_metadata(parse_controller(f"{file}:make").to_dict(), "here")
    with pytest.raises(ConfigError, match=r"^here: flown by a controller .* add: --controller \S*my_mpc.py:make$"):
        confirm_controller(flown, None, "here")
    entry = confirm_controller(flown, f"{file}:make", "here")
    assert (entry, entry.given) == (flown, True)
    copy = tmp_path / "copy.py"
    copy.write_bytes(file.read_bytes())
    moved = confirm_controller(flown, f"{copy}:make", "here")
    assert (moved.source, moved.name) == (f"{copy}:make", "my_mpc")
    for other in (f"{file}:fast", "exec: sh"):
        with pytest.raises(ConfigError, match=r"here: flown by controller '.*:make', not"):
            confirm_controller(flown, other, "here")
    file.write_text("make = dict\n")
    with pytest.raises(ConfigError, match=r"here: controller .* has changed"):
        confirm_controller(flown, f"{file}:make", "here")
    with pytest.raises(ConfigError, match="does not say"):
        parse_controller_metadata({}, "here")


def test_a_program_flies_again_by_the_same_words_alone():
    flown = parse_controller_metadata(parse_controller("exec: sh -c 'echo 1'").to_dict(), "here")
    assert confirm_controller(flown, 'exec:  sh -c "echo 1"', "here").given
    with pytest.raises(ConfigError, match="not 'exec: sh -c 'echo 2''"):
        confirm_controller(flown, "exec: sh -c 'echo 2'", "here")


def test_what_only_a_file_names_is_neither_loaded_nor_made(file, tmp_path):
    (tmp_path / "law.so").write_bytes(b"")
    for source, load in ((f"{tmp_path}/law.so", load_library), (f"{file}:make", lambda each: make_stepper(each, None))):
        entry = parse_controller_metadata(parse_controller(source).to_dict(), "here")
        with pytest.raises(ConfigError, match="a file names a controller that runs code"):
            load(entry)


def test_a_module_of_the_current_folder_is_found_last(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", [*sys.path])
    for name in ("mine_alone", "json"):
        (tmp_path / f"{name}.py").write_text("make = object\n")
    assert parse_controller("mine_alone:make").name == "mine_alone"
    assert sys.path[-1] == str(tmp_path)
    assert parse_controller("json:make").digest != parse_controller("mine_alone:make").digest
