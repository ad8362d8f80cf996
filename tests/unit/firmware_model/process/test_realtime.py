import gc
import os
import subprocess
import sys

import pytest

from firmware_model.process import realtime


@pytest.fixture
def collector():
    gc.enable()  # a process that flew in a test before may have left it off
    yield
    gc.unfreeze()
    gc.enable()


@pytest.mark.parametrize("off", [False, True])
def test_what_is_there_is_kept_from_the_collector_and_if_asked_for_all_that_comes(collector, off):
    gc.unfreeze()
    realtime.freeze_gc(off=off)
    assert gc.get_freeze_count() > 10_000
    assert gc.isenabled() is not off


def test_where_the_system_refuses_nothing_is_said(monkeypatch):
    def refuse(*_):
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    assert not realtime.request_fifo_scheduling()


def test_system_without_such_a_thing_goes_on(monkeypatch):
    monkeypatch.delattr(os, "SCHED_FIFO")
    assert not realtime.request_fifo_scheduling()


def test_process_goes_first_and_what_it_starts_does_not():
    script = (
        "import os, threading; from firmware_model.process import realtime\n"
        "first = realtime.request_fifo_scheduling()\n"
        "told = []; thread = threading.Thread(target=lambda: told.append(os.sched_getscheduler(0)))\n"
        "thread.start(); thread.join(); fifo = os.sched_getscheduler(0) & 7 == os.SCHED_FIFO\n"
        "print(first == fifo, told == [os.SCHED_OTHER])"
    )
    told = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert told.stdout.split() == ["True", "True"]
