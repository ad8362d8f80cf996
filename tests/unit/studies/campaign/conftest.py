from concurrent.futures import Future
from dataclasses import replace
from types import SimpleNamespace

import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.uncertainty import load_vehicle_set
from gustproof.law.form import load_law
from gustproof.studies.campaign.plan import Campaign, DispersionKind, select_spreads
from gustproof.studies.campaign.sampling import Sampling


@pytest.fixture
def planned():
    """Return a function that plans a campaign of short flights, with what is asked for changed."""

    def plan(wanted=tuple(DispersionKind), laws=("hinf-d1", "pid-fair"), cases=40, **changes):
        vehicles = load_vehicle_set("paper")
        scenario = replace(load_scenario("paper-turbulence"), duration_s=0.2)
        values = {"cases": cases, "sampling": Sampling.UNIFORM, "seed": 1, "scenario": scenario, **changes}
        spreads = select_spreads(vehicles, values["scenario"], wanted, gust=0.5, attitude_deg=2.0)
        return Campaign(laws=tuple(map(load_law, laws)), vehicles=vehicles, spreads=spreads, **values)

    return plan


@pytest.fixture
def here():
    """Return a pool without workers: what is submitted is done at once."""

    def submit(function, *arguments):
        future = Future()
        future.set_result(function(*arguments))
        return future

    return SimpleNamespace(death_errors=(), max_pending=1, submit=submit)
