"""Folders of runs; no run overwrites another."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from firmware_model.errors import ConfigError
from firmware_model.recording.durable_file import locked_folder

RUNS = Path("runs")


@contextmanager
def run_folder(out: Path | None, name: str) -> Iterator[Path]:
    """Make and yield `out`, or by default the next free `runs/<name>-001`, -002, …, for this process alone.

    The folder is locked meanwhile: of several that are given the same one, the first has it. What this process made and
    left empty is removed at the end.

    Raises
    ------
    ConfigError
        If `out` lies in no folder, is not an empty folder, or another process has it.
    """
    folder, made = _next_folder(name) if out is None else _make_folder(out)
    with locked_folder(folder) as is_ours:
        if not is_ours:
            raise ConfigError(f"{folder}: another process writes there")
        try:
            if any(folder.iterdir()):
                raise ConfigError(f"{folder}: exists already and is not an empty folder; nothing is overwritten")
            yield folder
        finally:
            if made:
                with suppress(OSError):  # not empty
                    folder.rmdir()
                    if folder.parent == RUNS:
                        RUNS.rmdir()


def _next_folder(name: str) -> tuple[Path, bool]:
    RUNS.mkdir(exist_ok=True)
    number = 1
    while True:
        folder = RUNS / f"{name}-{number:03d}"
        try:
            folder.mkdir()  # fails if another process took the number in the meantime
        except FileExistsError:
            number += 1
        else:
            return folder, True


def _make_folder(folder: Path) -> tuple[Path, bool]:
    """Return the folder, and whether it is made here."""
    try:
        folder.mkdir()
    except FileNotFoundError:
        raise ConfigError(f"{folder.parent}: no such folder") from None
    except FileExistsError:
        if not folder.is_dir():
            raise ConfigError(f"{folder}: exists already and is no folder; nothing is overwritten") from None
        return folder, False
    return folder, True


def find_bags(run: Path) -> list[Path]:
    """Return the bags in a run's folder by name; for a bag, return itself.

    Raises
    ------
    ConfigError
        If there is none, or no such folder.
    """
    if not run.is_dir():
        from firmware_model.config.files import tell_kind  # commands import this module for their help

        is_file = f"is a file, not the folder of a flight{tell_kind(run)}"
        raise ConfigError(f"{run}: {is_file if run.exists() else 'no such file or folder'}")
    folders = [run, *sorted(run.iterdir())]
    bags = [folder for folder in folders if (folder / "metadata.yaml").is_file()]
    if not bags:
        cut_off = any(path.suffix == ".journal" for path in folders)
        raise ConfigError(
            f"{run}: no bag in it" + (f"; a journal is: gustproof report {run} completes it" if cut_off else "")
        )
    return bags


def find_bag(run: Path) -> Path:
    """Return the one bag of a run's folder; for a bag, return itself.

    Raises
    ------
    ConfigError
        If there is none, or more than one.
    """
    first, *others = find_bags(run)
    if others:
        raise ConfigError(f"{run}: holds {1 + len(others)} bags; name one, such as {first}")
    return first
