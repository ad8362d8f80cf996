import pytest

from firmware_model.errors import ConfigError
from gustproof.entries.entry import EntryKind, find_entry, parse_entry

pytestmark = pytest.mark.plain


@pytest.fixture
def file(tmp_path):
    made = tmp_path / "my_mpc.py"
    made.write_text("make = object\n")
    return made


def test_each_way_in_has_its_kind_name_and_digest(file, tmp_path, monkeypatch):
    library = tmp_path / "law.so"
    library.write_bytes(b"")
    monkeypatch.syspath_prepend(tmp_path)
    found = [parse_entry(each) for each in (f"{file}:make", "my_mpc:fast", str(library), "exec: node ./mine.mjs")]
    kinds = EntryKind.PYTHON, EntryKind.PYTHON, EntryKind.LIBRARY, EntryKind.PROGRAM
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
        parse_entry(source)


def test_a_flown_entry_is_found_again_unless_its_file_has_changed(file):
    entry = parse_entry(f"{file}:make")
    assert find_entry(entry.to_dict(), "here") == entry
    file.write_text("make = dict\n")
    with pytest.raises(ConfigError, match=r"here: controller .* has changed"):
        find_entry(entry.to_dict(), "here")
    with pytest.raises(ConfigError, match="does not say"):
        find_entry({}, "here")
