"""Flights of the process that simulates for a real autopilot, in this process."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from firmware_model.external.__main__ import main


@pytest.fixture
def fly_script(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., dict[str, Any]]:
    """Return what flies a script with an autopilot's build in `tmp_path`, or a folder in it, and returns the facts."""

    def fly(autopilot: str, script: str, *options: str, build: str, folder: str = ".") -> dict[str, Any]:
        place = tmp_path / folder
        place.mkdir(exist_ok=True)
        (place / "short.toml").write_text(script)
        status = main(
            ["--autopilot", autopilot, "--build", build, "--folder", str(place / "run"), "--vehicle", "paper",
             "--scenario", str(place / "short.toml"), "--journal", str(place / "flight.journal"), *options]
        )  # fmt: skip
        facts: dict[str, Any] = json.loads(capsys.readouterr().out.splitlines()[-1])
        assert (status == 0) == (facts["outcome"] == "done"), facts
        return facts

    return fly
