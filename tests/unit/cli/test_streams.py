"""Streams that are closed, full or of another encoding, and signals at any moment: a status, a line, no traceback."""

import os
import signal
import subprocess
import sys

import pytest

from firmware_model.process.interrupts import call_on_interrupt
from gustproof.cli import signals, streams


def run(shell: str, **environment: str) -> subprocess.CompletedProcess[str]:
    words = ["sh", "-c", shell.replace("gustproof", f"{sys.executable} -m gustproof")]
    return subprocess.run(words, capture_output=True, text=True, timeout=120, env={**os.environ, **environment})


@pytest.mark.parametrize(
    ("shell", "status", "told"),
    [
        ("gustproof vehicle list >&-", 0, ""),
        ("gustproof vehicle list 2>&-", 0, ""),
        ("gustproof vehicle list <&- >&- 2>&-", 0, ""),
        ("gustproof fly nowhere 2>&-", 2, ""),
        ("gustproof fly nowhere 2>/dev/full", 2, ""),
        ("gustproof vehicle list > /dev/full", 2, "gustproof: standard output: No space left on device\n"),
        ("gustproof vehicle list --json > /dev/full", 2, "gustproof: standard output: No space left on device\n"),
        ("gustproof vehicle list > /dev/full 2>&1", 2, ""),
    ],
)
def test_closed_and_full_streams_cost_a_line_at_most(shell, status, told):
    done = run(shell)
    assert (done.returncode, done.stderr) == (status, told)


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_signs_that_the_terminal_lacks_are_replaced(encoding):
    done = run("gustproof scenario list", PYTHONIOENCODING=encoding)
    assert (done.returncode, done.stderr) == (0, "")
    assert "gust-roll" in done.stdout
    assert "≤ 1.5, 2 ≥ 1 ☃".encode(encoding, streams.SPELT) == b"<= 1.5, 2 >= 1 ?"


def test_a_file_never_takes_the_place_of_a_closed_stream(tmp_path):
    code = (
        "from gustproof.cli import streams; streams.prepare(); import sys; file = open(sys.argv[1], 'w'); "
        "print('lost', file=sys.stderr); import os; os.write(2, b'lost')"
    )
    path = tmp_path / "file"
    words = ["sh", "-c", f'exec "$0" -c "{code}" "$1" 2>&-', sys.executable, str(path)]
    subprocess.run(words, check=True, timeout=60)
    assert path.read_text() == ""


def test_what_takes_the_place_of_a_closed_stream_leaves_the_file_open():
    """A copied process has streams of its own: its standard input was closed, and no flight began."""
    code = (
        "import os, sys; from gustproof.cli import streams; streams.prepare(); sys.stdin = sys.stdout = None; "
        "os.fstat(0); os.fstat(1)"
    )
    done = subprocess.run(
        ["sh", "-c", f'exec "$0" -c "{code}" <&- >&-', sys.executable], capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
@pytest.mark.parametrize("place", ["before", "parser", "command", "after"])
def test_a_signal_at_any_moment_ends_in_one_line(name, place):
    code = f"""
import os, signal, sys
from gustproof import __main__
from gustproof.cli import app, streams
interrupt = lambda *_, **__: os.kill(os.getpid(), signal.{name})
place = {place!r}
if place == "before":
    streams.prepare = interrupt
elif place == "parser":  # commands are being made of functions
    import typer.main
    made = typer.main.get_group_from_info
    typer.main.get_group_from_info = lambda *args, **named: (interrupt(), made(*args, **named))[1]
elif place == "command":
    app.OneLineErrors.invoke.__globals__["copy_context"] = interrupt
else:
    streams.flush = interrupt
sys.argv = ["gustproof", "law", "list"]
__main__.main()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stderr) == (130, "gustproof: interrupted\n")


def test_a_hangup_that_nohup_ignores_stays_ignored():
    called: list[str] = []
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        for ignored in (True, False):
            signal.signal(signal.SIGHUP, signal.SIG_IGN if ignored else signal.SIG_DFL)
            call_on_interrupt(lambda: called.append("interrupt"))
            os.kill(os.getpid(), signal.SIGHUP)
            assert len(called) == (0 if ignored else 1)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def test_a_signal_in_a_callback_of_the_compiler_waits_until_it_has_returned(monkeypatch):
    monkeypatch.setitem(sys.modules, "llvmlite", sys.modules.get("llvmlite", os))
    inside: list[str] = []
    compiler = {"__name__": "llvmlite.binding.executionengine", "signal": signal, "inside": inside, "os": os}
    exec("def finalize():\n os.kill(os.getpid(), signal.SIGTERM)\n inside.append('whole')", compiler)
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)}
    try:
        signals.interrupt_commands()
        compiler["finalize"]()  # type: ignore[operator]
        assert inside == ["whole"]
        with pytest.raises(KeyboardInterrupt):
            signal.pause()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def test_nothing_slow_is_loaded_until_ctrl_c_has_its_handler():
    loads = "import sys; before = {*sys.modules}; import gustproof.__main__; print(*{*sys.modules} - before)"
    done = subprocess.run([sys.executable, "-c", loads], capture_output=True, text=True, check=True, timeout=60)
    ours = {"gustproof", "gustproof.version", "gustproof.cli", "gustproof.cli.signals", "gustproof.__main__"}
    assert ours <= set(done.stdout.split()) <= ours | {"_signal", "atexit", "gc"}


@pytest.mark.parametrize("files", [7, 9])
def test_too_few_open_files_are_named(files, tmp_path):
    done = run(f"ulimit -n {files}; cd {tmp_path} && gustproof fly calm")
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert "Too many open files" in done.stderr.splitlines()[-1]
