"""Machine code that is kept is used only if it is whole and this user's; else it is compiled again."""

import os
import pickle
import stat
import sys
from collections.abc import Callable
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest

from firmware_model.numerics import compiled as compiling
from firmware_model.numerics import kept_code
from firmware_model.numerics.compiled import find_cache

SOURCE = "def add(x):\n    return x + 1.0\n"
Damage = Callable[[Path], object]


@pytest.fixture
def load(tmp_path, monkeypatch):
    """Return a function that gives the entry point of a file as a new process would, and counts compilations."""
    monkeypatch.setattr(kept_code, "_CACHES", [])
    monkeypatch.setattr("numba.core.config.CACHE_DIR", "")
    source = tmp_path / "mine.py"
    source.write_text(SOURCE)

    def make() -> Any:
        spec = spec_from_file_location("mine", source)
        module = module_from_spec(spec)
        monkeypatch.setitem(sys.modules, "mine", module)  # code is loaded into its module, found by its name
        spec.loader.exec_module(module)
        return compiling.compiled(module.add)

    return make


def files(folder: Path) -> list[Path]:
    return sorted(path for path in (folder / "__pycache__").iterdir() if path.suffix in (".nbi", ".nbc"))


def is_warm(entry: Any) -> bool:
    """Return whether a call needs no compiler."""
    assert entry(1.0) == 2.0
    return sum(entry._cache_hits.values()) == 1


class Evil:
    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self):
        return os.mkdir, (str(self.folder / "PWNED"),)


def overwrite(content: bytes) -> Damage:
    return lambda path: path.write_bytes(content)


def cut(size: int) -> Damage:
    return lambda path: os.truncate(path, size)


def flip(at: int) -> Damage:
    def damage(path: Path) -> None:
        content = bytearray(path.read_bytes())
        content[at] ^= 1
        path.write_bytes(content)

    return damage


def become_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


DAMAGES: dict[str, Damage] = {
    **{f"cut at {size}": cut(size) for size in (0, 1, 31, 32, 33, 40, 100)},
    **{f"flipped at {at}": flip(at) for at in (0, 31, 32, 40, 80, -1)},
    "garbage": overwrite(os.urandom(500)),
    "zeros": overwrite(bytes(500)),
    "pickle that runs": lambda path: path.write_bytes(pickle.dumps(Evil(path.parents[1]))),
    "pickle that runs behind a head": lambda path: path.write_bytes(bytes(32) + pickle.dumps(Evil(path.parents[1]))),
    "longer": lambda path: path.write_bytes(path.read_bytes() + b"x"),
    "writable by all": lambda path: path.chmod(0o666),
    "writable by its group": lambda path: path.chmod(0o660),
    "pipe": become_pipe,
    "gone": Path.unlink,
}


@pytest.mark.slow
@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_damaged_code_is_compiled_again_and_then_whole(load, tmp_path, damage, which):
    assert not is_warm(load())
    assert is_warm(load())
    (path,) = (path for path in files(tmp_path) if path.suffix == (".nbc", ".nbi")[which])
    damage(path)
    told = [] if damage is Path.unlink else [path]
    kept_code._CACHES.clear()
    again = load()
    assert kept_code.find_damaged() == told
    assert not is_warm(again)
    assert kept_code.find_damaged() == []
    assert is_warm(load())
    assert not (tmp_path / "PWNED").exists()


def test_kept_code_is_private_and_told_by_its_sources(load, tmp_path):
    entry = load()
    assert find_cache(entry) == (tmp_path / "__pycache__", False, False)
    is_warm(entry)
    assert find_cache(load()) == (tmp_path / "__pycache__", True, False)
    assert {stat.S_IMODE(path.stat().st_mode) for path in files(tmp_path)} == {0o600}
    other = load()
    other._cache.set_stamp("other sources")
    assert not is_warm(other)


def test_a_file_does_not_stand_for_another(load, tmp_path):
    is_warm(load())
    (code,) = (path for path in files(tmp_path) if path.suffix == ".nbc")
    assert kept_code._read_sealed(code) is not None
    moved = code.rename(code.with_name("other.nbc"))
    assert kept_code._read_sealed(moved) is None


@pytest.mark.skipif(os.name == "nt" or os.geteuid() != 0, reason="only root gives files away")
def test_code_of_another_user_is_not_used(load, tmp_path):
    is_warm(load())
    for path in files(tmp_path):
        os.chown(path, 65534, 65534)
    assert not is_warm(load())
    assert is_warm(load())


def test_a_disk_that_takes_nothing_keeps_nothing(load, monkeypatch):
    def write(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(kept_code, "_write_sealed", write)
    assert not is_warm(load())
    assert not is_warm(load())


def test_without_a_lasting_folder_a_private_temporary_one_keeps_code(load, tmp_path, monkeypatch):
    monkeypatch.setattr(kept_code._Places, "_locator_classes", (kept_code._TemporaryFolder,))
    monkeypatch.setattr(kept_code.tempfile, "gettempdir", lambda: str(tmp_path))
    is_warm(load())
    entry = load()
    found = find_cache(entry)
    assert (found.temporary, is_warm(entry)) == (True, True)
    top = tmp_path / f"gustproof-{os.geteuid()}"
    assert (found.folder.parent, stat.S_IMODE(top.stat().st_mode)) == (top, 0o700)
    top.chmod(0o777)
    assert find_cache(load()) is None
    assert not is_warm(load())
    top.chmod(0o700)
    top.rename(tmp_path / "elsewhere")
    top.symlink_to(tmp_path / "elsewhere")
    assert find_cache(load()) is None
    top.unlink()
    monkeypatch.chdir(tmp_path)
    assert find_cache(load()) is None
    assert not top.exists()
