"""Output folders never take another run's place."""

import subprocess
import sys
from contextlib import ExitStack

import pytest

from firmware_model.errors import ConfigError
from gustproof.flight.recording.folder import run_folder


def test_default_folders_are_numbered_and_each_is_new(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with ExitStack() as stack:
        made = [stack.enter_context(run_folder(None, "fly")) for _ in range(3)]
        assert [str(folder) for folder in made] == ["runs/fly-001", "runs/fly-002", "runs/fly-003"]
        assert all(folder.is_dir() for folder in made)
    assert list(tmp_path.iterdir()) == []  # none of them was used


def test_an_asked_folder_may_be_new_or_empty_and_only_a_new_one_is_removed_unused(tmp_path):
    (tmp_path / "empty").mkdir()
    for name in ("empty", "new"):
        with run_folder(tmp_path / name, "fly") as folder:
            assert (folder, folder.is_dir()) == (tmp_path / name, True)
    assert [path.name for path in tmp_path.iterdir()] == ["empty"]
    with run_folder(tmp_path / "used", "fly") as folder:
        (folder / "flight").touch()
    assert (tmp_path / "used/flight").exists()


@pytest.mark.parametrize("taken", ["file", "folder", "link"])
def test_a_taken_place_is_refused(tmp_path, taken):
    place = tmp_path / "out"
    if taken == "file":
        place.write_text("mine")
    elif taken == "link":
        place.symlink_to("nowhere")
    else:
        place.mkdir()
        (place / "mine").touch()
    with pytest.raises(ConfigError, match="nothing is overwritten"), run_folder(place, "fly"):
        pass
    assert place.is_symlink() or place.exists()


def test_a_folder_in_no_folder_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="b: no such folder"), run_folder(tmp_path / "b" / "c", "fly"):
        pass


CLAIM = """
import sys, time
from pathlib import Path
from firmware_model.errors import ConfigError
from gustproof.flight.recording.folder import run_folder
print("ready", flush=True)
sys.stdin.readline()
try:
    with run_folder(Path(sys.argv[1]), "fly") as folder:
        (folder / "flight").touch(exist_ok=False)
        print("won", flush=True)
        sys.stdin.readline()
except ConfigError as error:
    print(error, flush=True)
"""


@pytest.mark.parametrize("exists", [False, True])
def test_of_several_processes_in_one_folder_one_has_it_and_the_others_leave_it_alone(exists, tmp_path):
    place = tmp_path / "same"
    if exists:
        place.mkdir()
    words = [sys.executable, "-c", CLAIM, str(place)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with ExitStack() as stack:
        processes = [stack.enter_context(subprocess.Popen(words, **pipes)) for _ in range(4)]
        for process in processes:
            assert process.stdout.readline() == "ready\n"
        for process in processes:
            process.stdin.write("\n")
            process.stdin.flush()
        told = sorted(process.stdout.readline() for process in processes)
        for process in processes:
            process.communicate("\n", timeout=20)
    assert told.count("won\n") == 1
    refused = ("another process writes there", "nothing is overwritten")
    assert sum(line.strip().endswith(refused) for line in told) == 3
    assert [path.name for path in place.iterdir()] == ["flight"]
