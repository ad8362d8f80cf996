"""Output folders never take another run's place."""

import errno
from pathlib import Path

import pytest

from firmware_model.errors import ConfigError
from gustproof.recording.folder import make_run_folder, write_atomic


def test_default_folders_are_numbered_and_each_is_new(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    made = [make_run_folder(None, "fly") for _ in range(3)]
    assert [str(folder) for folder in made] == ["runs/fly-001", "runs/fly-002", "runs/fly-003"]
    assert all(folder.is_dir() for folder in made)


def test_an_asked_folder_may_be_new_or_empty(tmp_path):
    (tmp_path / "empty").mkdir()
    assert make_run_folder(tmp_path / "empty", "fly") == tmp_path / "empty"
    assert make_run_folder(tmp_path / "a" / "b", "fly").is_dir()


@pytest.mark.parametrize("taken", ["file", "folder"])
def test_a_taken_place_is_refused(tmp_path, taken):
    place = tmp_path / "out"
    if taken == "file":
        place.write_text("mine")
    else:
        place.mkdir()
        (place / "mine").touch()
    with pytest.raises(ConfigError, match="nothing is overwritten"):
        make_run_folder(place, "fly")


def test_a_file_is_written_whole_or_left_as_it_was(tmp_path, monkeypatch):
    path = tmp_path / "page.html"
    write_atomic(path, "one")
    write_atomic(path, "another")

    def full(place, text, **_):
        place.write_bytes(text[:2].encode())
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(OSError, match=r"No space left on device: .*page\.html") as caught:
        write_atomic(path, "a third")
    assert caught.value.filename == str(path)
    assert path.read_bytes() == b"another"
    assert [each.name for each in tmp_path.iterdir()] == ["page.html"]
