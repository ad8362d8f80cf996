import signal
import time

import pytest

from firmware_model import status

FIGURES = {"in": 3, "out": 4, "lost": 1, "bad": 2, "rejected": {"stale": 5, "duplicate": 6}}


def test_line_names_each_peer_that_speaks_with_its_figures():
    text = status.line({"127.0.0.1:14550": FIGURES, "127.0.0.1:14540": {**FIGURES, "in": 0}}, 200)
    assert text == "127.0.0.1:14550 in 3 out 4 lost 1 bad 2 rejected 11"


def test_line_is_no_wider_than_the_terminal():
    assert len(status.line({str(number): FIGURES for number in range(9)}, 80)) == 80


def test_nobody_is_said_too():
    assert status.line({}, 80) == "nobody is connected"


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="this system has no interval timer")
def test_line_is_renewed_until_the_end(monkeypatch, capsys):
    monkeypatch.setattr(status, "PERIOD_S", 0.001)
    before = signal.getsignal(signal.SIGALRM)
    asked: list[int] = []
    with status.shown(lambda: asked.append(1) or {"peer": FIGURES}):
        while len(asked) < 3:
            time.sleep(0.001)
    signal.signal(signal.SIGALRM, before)
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    written = capsys.readouterr().err
    assert written.count("\rpeer in 3") >= 3
    assert written.endswith("\n")
