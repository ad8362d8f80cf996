"""The page on the protocol shows its clients as they run, short, and names each end and parameter rightly."""

import re
from importlib.resources import files

import pytest

from firmware_model.autopilot.parameters import Parameters
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.flight.routes.outcome import FlightOutcome

GUIDE = files("gustproof.guide")
PAGE = (GUIDE / "protocol.md").read_text(encoding="utf-8")
MOST_LINES = 40


@pytest.mark.parametrize(("language", "name"), [("python", "client.py"), ("c", "client.c"), ("js", "client.mjs")])
def test_block_of_code_is_the_client_and_short(language, name):
    (block,) = re.findall(rf"^```{language}\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL)
    assert block == (GUIDE / "clients" / name).read_text(encoding="utf-8")
    assert len(block.splitlines()) <= MOST_LINES
    assert max(map(len, block.splitlines())) <= 120


def test_ends_and_parameters_are_those_of_the_code():
    ends = re.findall(r"^\| `(\w+)` \|", PAGE, flags=re.MULTILINE)
    assert len(ends) == 8
    assert {name.upper() for name in ends} <= {outcome.name for outcome in FlightOutcome}
    table = {parameter.name for parameter in Parameters(load_vehicle("paper"), load_scenario("calm")).table}
    assert {"GP_TRQ_MAX_R", "IMU_INTEG_RATE", "MPC_THR_HOVER"} <= table
    assert all(name in PAGE for name in ("GP_TRQ_MAX_R", "IMU_INTEG_RATE", "MPC_THR_HOVER"))
