"""The guard of a program: what it passes on, how it ends the program, and what it says of the end."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

ADDRESS = "127.0.0.1:14580"


def guard(*words: str) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "gustproof.flight.endpoint.guard", *words]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def tell(program: "subprocess.Popen[str]", line: str) -> None:
    """Write a line to its standard input, which stays open."""
    assert program.stdin is not None
    program.stdin.write(f"{line}\n")
    program.stdin.flush()


def test_a_program_gets_the_address_and_its_last_line_is_told() -> None:
    script = 'echo before >&2; echo "$GUSTPROOF_ADDRESS $1" >&2; echo >&2; echo unseen; exit 3'
    with guard("sh", "-c", script, "sh", "to={address}") as program:
        tell(program, ADDRESS)
        assert program.stdout is not None
        told = json.loads(program.stdout.read())
    assert told == {"status": 3, "message": f"'sh' ended with status 3: {ADDRESS} to={ADDRESS}"}
    assert program.returncode == 3


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc")
@pytest.mark.parametrize(
    ("number", "status"), [(0, signal.SIGTERM), (signal.SIGTERM, signal.SIGTERM), (signal.SIGQUIT, signal.SIGKILL)]
)
def test_a_program_ends_with_its_starter_and_by_a_signal(number: int, status: signal.Signals) -> None:
    with guard("sleep", "60") as program:
        tell(program, ADDRESS)
        if number:
            caught = 0
            while not caught >> (signal.SIGTERM - 1) & 1:  # until its handlers stand
                lines = Path(f"/proc/{program.pid}/status").read_text(encoding="ascii").split("SigCgt:")
                caught = int(lines[1].split()[0], 16)
            program.send_signal(number)
        told = json.loads(program.communicate(timeout=60)[0])
    assert (told["status"], program.returncode) == (-status, 128 + status)
    assert told["message"] == f"'sleep' was ended by {status.name}"


def test_without_an_address_nothing_is_started() -> None:
    with guard("sh", "-c", "echo started >&2; exit 1") as program:
        assert (program.communicate("")[0], program.wait(timeout=60)) == ("", 130)
