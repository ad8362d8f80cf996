"""The controllers of the guide fly as they stand."""

import re
import shutil
import subprocess
from dataclasses import replace
from importlib.resources import files

import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.flight.controllers.user_controller import parse_controller
from gustproof.flight.routes.controllers import fly_controller
from gustproof.flight.routes.outcome import FlightOutcome

GUIDE = (files("gustproof.guide") / "controllers.md").read_text(encoding="utf-8")
AIR = replace(load_scenario("paper-turbulence"), duration_s=0.6)


def code(language: str) -> str:
    (found,) = re.findall(rf"^```{language}\n(.*?)^```", GUIDE, flags=re.MULTILINE | re.DOTALL)
    return found


def flown(source: str) -> None:
    flight = fly_controller(AIR, parse_controller(source), vehicle=load_vehicle("paper"))
    assert flight.outcome is FlightOutcome.DONE
    assert abs(flight.records["omega_B"]).max() < 0.2  # [rad/s]


def test_the_object_of_python_holds_the_vehicle(tmp_path):
    (tmp_path / "mine.py").write_text(code("python"))
    flown(f"{tmp_path}/mine.py:make")


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
def test_the_library_of_c_holds_the_vehicle(tmp_path):
    (tmp_path / "mine.c").write_text(code("c"))
    command = ["gcc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "mine.c", "-o", "mine.so"]
    subprocess.run(command, cwd=tmp_path, check=True)
    flown(f"{tmp_path}/mine.so")


def test_every_end_of_a_controller_is_told():
    told = set(re.findall(r"^\| `(controller_\w+)`", GUIDE, flags=re.MULTILINE))
    ends = {end.name.lower() for end in FlightOutcome if end.name.startswith("CONTROLLER_")}
    assert told == ends - {"controller_lost"}
