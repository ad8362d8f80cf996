import signal
import time

import pytest

from firmware_model.process import status_line

FIGURES = {"in": 3, "out": 4, "lost": 1, "bad": 2, "rejected": {"stale": 5, "duplicate": 6}}


def test_line_names_each_peer_that_speaks_with_its_figures():
    text = status_line.format_line({"127.0.0.1:14550": FIGURES, "127.0.0.1:14540": {**FIGURES, "in": 0}}, 200)
    assert text == "127.0.0.1:14550 in 3 out 4 lost 1 bad 2 rejected 11"


def test_line_is_no_wider_than_the_terminal():
    assert len(status_line.format_line({str(number): FIGURES for number in range(9)}, 80)) == 80


def test_nobody_is_said_too():
    assert status_line.format_line({}, 80) == "no peer is connected"


FACTS = {
    "outcome": "interrupted", "samples": 9862, "of": None, "wall_s": 39.448006, "slipped_s": 0.0,
    "realtime_factor": 1.0, "pace": None, "counters": {}, "links": {}, "link_faults": {},
}  # fmt: skip
PACE = {"missed": 1, "held": 0, "late_p50_us": 5, "late_p99_us": 80, "late_worst_us": 4461, "fifo": True}


def test_ending_is_one_line_where_nothing_happened():
    assert status_line.format_summary(FACTS) == "interrupted: 9862 samples in 39.4 s, speed 1.00x real time"


def test_ending_has_a_line_for_each_thing_that_happened():
    told = {"127.0.0.1:14550": FIGURES, "127.0.0.1:14540": {**FIGURES, "in": 0}}
    facts = {
        **FACTS, "outcome": "stream_lost", "of": 10000, "slipped_s": 0.25, "pace": PACE, "links": told,
        "counters": {"held": 3, "stale": 5}, "link_faults": {"to_controller": {"lost": 2}, "to_vehicle": {}},
    }  # fmt: skip
    assert status_line.format_summary(facts).splitlines() == [
        "stream lost: 9862 of 10000 samples in 39.4 s, speed 1.00x real time",
        "  deadlines          1 missed; late by 5 us (median), 80 us (99 %), 4461 us (worst), with FIFO scheduling",
        "  slipped            0.250 s of wall time",
        "  counted            held 3, stale 5",
        "  127.0.0.1:14550    in 3 out 4 lost 1 bad 2 rejected 11",
        "  link to_controller lost 2",
        "  link to_vehicle    no faults",
    ]


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="this system has no interval timer")
def test_line_is_renewed_until_the_end(monkeypatch, capsys):
    monkeypatch.setattr(status_line, "PERIOD_S", 0.001)
    before = signal.getsignal(signal.SIGALRM)
    asked: list[int] = []
    with status_line.show_status_line(lambda: asked.append(1) or {"peer": FIGURES}):
        while len(asked) < 3:
            time.sleep(0.001)
    signal.signal(signal.SIGALRM, before)
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    written = capsys.readouterr().err
    assert written.count("\rpeer in 3") >= 3
    assert written.endswith("\n")
