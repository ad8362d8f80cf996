"""Another simulator: its environment, made once, and its program, which flies on request."""

import json
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from signal import SIGKILL
from threading import Timer
from typing import Self

INSTALL_S, START_S, FLIGHT_S = 900.0, 300.0, 120.0
"""Time limits [s] of an installation, of a program's start with its first flight, and of each later flight."""


class PeerError(Exception):
    """A peer cannot be measured; the message is the reason, in one line."""


def environment(folder: Path, packages: Sequence[str], *, new: bool) -> Path:
    """Return the interpreter of the environment with exactly these packages, and make it if `new` allows."""
    python, made, wanted = folder / "bin" / "python", folder / "installed", " ".join(packages)
    if python.exists() and made.exists() and made.read_text(encoding="utf-8") == wanted:
        return python
    if not new:
        raise PeerError("no environment, and --quick does not make one")
    print(f"tools/bench: installing {wanted}, once; at most {INSTALL_S / 60.0:.0f} minutes", flush=True)
    begun = time.perf_counter()
    shutil.rmtree(folder, ignore_errors=True)
    try:
        _run([sys.executable, "-m", "venv", str(folder)], INSTALL_S)
        pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile"]
        _run([*pip, *packages], INSTALL_S - (time.perf_counter() - begun))
    except PeerError:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    made.write_text(wanted, encoding="utf-8")
    print(f"tools/bench: installed in {time.perf_counter() - begun:.0f} s", flush=True)
    return python


def _run(command: list[str], limit_s: float) -> None:
    try:
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, timeout=limit_s)
    except subprocess.TimeoutExpired as error:
        raise PeerError(f"not installed in {limit_s:.0f} s") from error
    except subprocess.CalledProcessError as error:
        raise PeerError(
            _last_line(error.stderr.decode(errors="replace")) or f"exit status {error.returncode}"
        ) from error


class Program:
    """Running program of a peer. It answers the rate of its first flight, and of one more for each input line."""

    def __init__(self, command: list[str], errors: Path) -> None:
        self._errors = errors
        with errors.open("w", encoding="utf-8") as log:
            # Some write logs to their working folder.
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True, cwd=errors.parent
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.communicate()

    def ready(self, limit_s: float = START_S) -> None:
        """Wait for the first flight, so that compilation is not measured."""
        self._answer(limit_s)

    def fly(self, limit_s: float = FLIGHT_S) -> float:
        """Fly once, and return the simulated seconds per second."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write("\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            pass  # it has ended; `_answer` gives the reason
        return self._answer(limit_s)

    def _answer(self, limit_s: float) -> float:
        """Return the next rate; skip the lines that libraries print."""
        assert self._process.stdout is not None
        timer = Timer(limit_s, self._process.kill)
        timer.start()
        try:
            for line in self._process.stdout:
                if line.startswith('{"rate"'):
                    return float(json.loads(line)["rate"])
        finally:
            timer.cancel()
        status = self._process.wait()
        if status == -SIGKILL:
            raise PeerError(f"not done in {limit_s:g} s")
        raise PeerError(_last_line(self._errors.read_text(errors="replace")) or f"exit status {status}")


def _last_line(text: str) -> str:
    lines = text.strip().splitlines()
    return lines[-1].strip() if lines else ""
