"""A league that was killed goes on to the same bytes."""

import signal
import subprocess
import sys
from pathlib import Path

from gustproof.show.report.html.league_page import render_league_page, write_league_page
from gustproof.studies.league.study import fly_league

PATIENCE_S = 120.0
PLAN = """
from concurrent.futures import ThreadPoolExecutor
from firmware_model.config.uncertainty import load_vehicle_set
from gustproof.studies.league.course import load_course
from gustproof.studies.league.entries import parse_league_entry
from gustproof.studies.league.study import LeaguePlan, fly_league

class Pool(ThreadPoolExecutor):
    death_errors, max_pending = (), 2

plan = LeaguePlan(
    entries=(parse_league_entry("hinf-d1"), parse_league_entry("pid-fair")),
    vehicles=(load_vehicle_set("paper"),),
    scenarios=tuple(load_course(["gust-50ms", "kick-all-axes"])),
    runs=2,
)
"""
KILLED = (
    PLAN
    + """
import os, signal, sys
from pathlib import Path

def kill(share, label):
    if label == "kick-all-axes, paper":
        os.kill(os.getpid(), signal.SIGKILL)

fly_league(plan, Path(sys.argv[1]), Pool(1), progress=kill)
"""
)


def test_league_that_was_killed_goes_on_to_the_same_bytes(tmp_path: Path, browser, axe) -> None:
    made: dict = {}
    exec(PLAN, made)
    whole = fly_league(made["plan"], tmp_path / "whole", made["Pool"](1))
    killed = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path / "cut")], timeout=PATIENCE_S, check=False)
    assert killed.returncode == -signal.SIGKILL
    kept = {path.name for path in (tmp_path / "cut").iterdir()}
    assert "gust-50ms-paper.parquet" in kept
    resumed = fly_league(made["plan"], tmp_path / "cut", made["Pool"](1))
    assert render_league_page(resumed) == render_league_page(whole)
    assert resumed.to_dict() == whole.to_dict()
    files = {path.name: path.read_bytes() for path in (tmp_path / "whole").iterdir()}
    assert {path.name: path.read_bytes() for path in (tmp_path / "cut").iterdir()} == files
    assert kept < set(files)
    write_league_page(whole, tmp_path / "league.html")
    browser.look_at((tmp_path / "league.html").as_uri(), "league", tmp_path, axe)
    assert browser.run("document.querySelectorAll('.forest .disc').length") == len(whole.order)
