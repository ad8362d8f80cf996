"""Files and folders are written whole, or what was there stays as it was."""

import errno
import os
import resource
import stat
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import pytest

from firmware_model.config.whole_file import OVERWRITES, whole_file, write_files, write_folder
from firmware_model.errors import ConfigError


def write(path: Path, content: bytes, **options: bool) -> None:
    with whole_file(path, **options) as file:
        file.write(content)


def names(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


@contextmanager
def full_disk(size: int):
    """Let no file of this process grow beyond `size` bytes, as on a full disk; Python ignores the signal."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


@contextmanager
def keeping():
    token = OVERWRITES.set(False)
    try:
        yield
    finally:
        OVERWRITES.reset(token)


def test_a_file_on_a_full_disk_stays_as_it_was_and_is_named(tmp_path):
    path = tmp_path / "law.json"
    write(path, b"before")
    with full_disk(4096), pytest.raises(OSError, match=r"law\.json") as caught:
        write(path, bytes(10_000))
    assert (caught.value.errno, caught.value.filename) == (errno.EFBIG, str(path))
    assert (names(tmp_path), path.read_bytes()) == (["law.json"], b"before")


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_an_interruption_leaves_nothing(error, tmp_path):
    with suppress(error), whole_file(tmp_path / "law.json") as file:
        file.write(b"half")
        raise error
    assert names(tmp_path) == []


def test_an_error_about_another_file_keeps_its_name(tmp_path):
    with pytest.raises(FileNotFoundError) as caught, whole_file(tmp_path / "out"):
        (tmp_path / "source").read_bytes()
    assert caught.value.filename == str(tmp_path / "source")


def test_no_link_is_followed(tmp_path):
    (tmp_path / "theirs").write_bytes(b"precious")
    (tmp_path / "out").symlink_to("theirs")
    write(tmp_path / "out", b"mine")
    assert (tmp_path / "theirs").read_bytes() == b"precious"
    assert not (tmp_path / "out").is_symlink()
    (tmp_path / "dangling").symlink_to("nowhere")
    with pytest.raises(FileExistsError):
        write(tmp_path / "dangling", b"mine", overwrite=False)
    assert not (tmp_path / "nowhere").exists()


def test_a_new_file_has_the_usual_mode_and_an_old_one_keeps_its_own(tmp_path):
    mask = os.umask(0o027)
    try:
        write(tmp_path / "new", b"")
        (tmp_path / "old").touch()
        (tmp_path / "old").chmod(0o600)
        write(tmp_path / "old", b"")
    finally:
        os.umask(mask)
    assert [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("new", "old")] == [0o640, 0o600]


@pytest.mark.parametrize("links", [True, False])
def test_a_file_that_came_meanwhile_is_not_overwritten(links, tmp_path, monkeypatch):
    def refused(*_):
        raise PermissionError(errno.EPERM, "Operation not permitted")

    if not links:
        monkeypatch.setattr("os.link", refused)
    path = tmp_path / "law.json"
    with ExitStack() as stack:
        stack.enter_context(pytest.raises(FileExistsError, match=r"law\.json"))
        stack.enter_context(whole_file(path, overwrite=False)).write(b"mine")
        path.write_bytes(b"theirs")
    assert (names(tmp_path), path.read_bytes()) == (["law.json"], b"theirs")
    path.unlink()
    write(path, b"mine", overwrite=False)
    assert (names(tmp_path), path.read_bytes()) == (["law.json"], b"mine")


def test_files_that_belong_together_are_written_all_or_none(tmp_path):
    header, source = tmp_path / "law.h", tmp_path / "law.c"
    with full_disk(4096), pytest.raises(OSError, match=r"law\.c") as caught:
        write_files({header: "short", source: "long" * 4096})
    assert (caught.value.filename, names(tmp_path)) == (str(source), [])
    write_files({header: "short", source: "long"})
    assert names(tmp_path) == ["law.c", "law.h"]


def test_a_folder_is_written_whole_or_not_at_all(tmp_path):
    folder = tmp_path / "module"
    with full_disk(4096), pytest.raises(OSError, match="module") as caught:
        write_folder(folder, {"README.md": "short", "src/law.c": "long" * 4096})
    assert (caught.value.filename, names(tmp_path)) == (str(folder), [])
    folder.mkdir()
    write_folder(folder, {"README.md": "short", "src/law.c": b"long"})
    assert names(folder) == ["README.md", "src", "src/law.c"]


def test_a_folder_is_replaced_on_demand_and_only_if_it_has_no_other_files(tmp_path):
    folder = tmp_path / "module"
    write_folder(folder, {"README.md": "one", "old.c": "old"})
    with keeping(), pytest.raises(ConfigError, match="exists already; --force overwrites it"):
        write_folder(folder, {"README.md": "two", "old.c": ""})
    with pytest.raises(ConfigError, match=r"holds other files, such as old\.c"):
        write_folder(folder, {"README.md": "two"})
    write_folder(folder, {"README.md": "two", "old.c": "new", "more.c": ""})
    assert (names(tmp_path), (folder / "README.md").read_text()) == (
        ["module", "module/README.md", "module/more.c", "module/old.c"],
        "two",
    )


@pytest.mark.parametrize("taken", ["file", "link"])
def test_a_file_or_a_link_is_no_folder_to_write(taken, tmp_path):
    (tmp_path / "theirs").mkdir()
    if taken == "file":
        (tmp_path / "out").touch()
    else:
        (tmp_path / "out").symlink_to("theirs")
    with pytest.raises(ConfigError, match="is no folder"):
        write_folder(tmp_path / "out", {"a": "b"})
    assert names(tmp_path / "theirs") == []
