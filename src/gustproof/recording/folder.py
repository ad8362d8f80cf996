"""Folders of runs; no run overwrites another."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from firmware_model.errors import ConfigError, naming

RUNS = Path("runs")


def make_run_folder(out: Path | None, name: str) -> Path:
    """Make and return `out`, or by default the next free `runs/<name>-001`, -002, ….

    Raises
    ------
    ConfigError
        If `out` exists and is not an empty folder.
    """
    if out is not None:
        if out.exists() and not (out.is_dir() and not any(out.iterdir())):
            raise ConfigError(f"{out}: exists already and is not an empty folder; nothing is overwritten")
        out.mkdir(parents=True, exist_ok=True)
        return out
    RUNS.mkdir(exist_ok=True)
    number = 1
    while True:
        folder = RUNS / f"{name}-{number:03d}"
        try:
            folder.mkdir()  # fails if another process took the number in the meantime
        except FileExistsError:
            number += 1
        else:
            return folder


@contextmanager
def unless_refused(folder: Path) -> Iterator[None]:
    """Remove a run's folder if its flight is refused and left nothing there, and an empty folder of runs."""
    try:
        yield
    except ConfigError:
        with suppress(OSError):  # not empty
            folder.rmdir()
            if folder.parent == RUNS:
                RUNS.rmdir()
        raise


def write_atomic(path: Path, text: str) -> None:
    """Write a file whole, or leave an existing one unchanged.

    Raises
    ------
    OSError
        If it can't be written; the error names it.
    """
    unfinished = path.with_name(f".{path.name}")
    try:
        with naming(path):
            unfinished.write_text(text, encoding="utf-8")
            unfinished.replace(path)
    except OSError:
        unfinished.unlink(missing_ok=True)
        raise


def find_bags(run: Path) -> list[Path]:
    """Return the bags in a run's folder by name; for a bag, return itself.

    Raises
    ------
    ConfigError
        If there is none, or no such folder.
    """
    if not run.is_dir():
        raise ConfigError(f"{run}: no such folder")
    folders = [run, *sorted(run.iterdir())]
    bags = [folder for folder in folders if (folder / "metadata.yaml").is_file()]
    if not bags:
        cut_off = any(path.suffix == ".journal" for path in folders)
        raise ConfigError(f"{run}: no bag in it" + (f"; a journal is: gustproof recover {run}" if cut_off else ""))
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
