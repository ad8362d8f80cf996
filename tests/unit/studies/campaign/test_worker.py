import json
from dataclasses import replace
from types import SimpleNamespace

import pytest

from firmware_model.config.events import Payload
from firmware_model.config.link_faults import LinkDelay
from firmware_model.config.uncertainty import VehicleSet
from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from gustproof.flight.controllers.external_autopilot import ExternalAutopilot
from gustproof.flight.controllers.user_controller import parse_controller
from gustproof.flight.routes.batch import Case
from gustproof.flight.routes.controllers import fly_controller
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.outcome import FlightOutcome
from gustproof.flight.scoring.metrics import measure
from gustproof.flight.scoring.requirements import judge
from gustproof.law.form import load_law
from gustproof.studies.campaign import worker
from gustproof.studies.campaign.plan import DispersionKind, parse_campaign, trust
from gustproof.studies.campaign.rerun import CampaignRun
from gustproof.studies.campaign.worker import FIGURES, Chunk, fly_chunk

CASE = Case(vehicle=load_vehicle("paper"), seed=5)


def flown(campaign, first=0, runs=12):
    return fly_chunk(json.dumps(campaign.metadata()), Chunk(first, runs)).table.to_pylist()


def test_a_row_is_what_the_flight_alone_leaves(planned):
    campaign = planned(cases=5)
    row = flown(campaign, first=7, runs=2)[1]
    assert (row["run"], row["case"], row["law"], row["failure"]) == (8, 3, "pid-fair", None)
    case = campaign.make_case(campaign.draw_deltas(3, 1)[0].tolist(), campaign.flight_seeds(3, 1)[0])
    scenario = case.apply_to(campaign.scenario)
    records = fly_direct(scenario, campaign.laws[1], vehicle=case.vehicle, seed=case.seed)
    figures = measure(records, case.vehicle, scenario)
    assert [row[name] for name in FIGURES] == [getattr(figures, name) for name in FIGURES]
    required = judge(records, scenario, case.vehicle)
    assert [row["require_0_rho_share"], row["require_1_saturated_s"]] == [result.value for result in required]
    assert row["held"] == all(result.is_met for result in required)


def test_a_case_that_can_t_be_flown_costs_the_others_nothing(planned):
    heavy = Payload(kind="payload", at_s=0.1, mass_kg=0.0, inertia_kgm2=(-0.25, 0.0, 0.0))
    campaign = planned([DispersionKind.VEHICLE], laws=("hinf-d1",), cases=12)
    campaign = planned(
        [DispersionKind.VEHICLE], laws=("hinf-d1",), cases=12, scenario=replace(campaign.scenario, event=(heavy,))
    )
    rows = flown(campaign)
    impossible = [row["delta_inertia_B_x"] <= 0.0 for row in rows]
    assert 0 < sum(impossible) < 12
    assert [row["failure"] is not None for row in rows] == impossible
    assert [row["rmse_deg"] is None for row in rows] == impossible
    assert all("inertia_B.0" in row["failure"] for row in rows if row["failure"])
    assert not any(row["held"] for row in rows if row["failure"])


def test_a_flight_that_diverges_is_recorded_with_its_time(planned):
    campaign = planned([], laws=("hinf-d1",), cases=2)
    light = {**campaign.vehicles.document, "inertia_B": [1e-300, 1.0, 1.0], "actuator_lag": 0.05}
    rows = flown(replace(campaign, vehicles=VehicleSet(document=light)), runs=2)
    for row in rows:
        assert row["failure"].startswith("diverged at 0.")
        assert row["rmse_deg"] is None
        assert row["held"] is False


def test_a_scenario_with_events_of_the_link_is_flown_by_messages(planned):
    direct = planned([DispersionKind.GUST], laws=("hinf-d1",), cases=2)
    faults = (LinkDelay(kind="delay", direction="to_controller", delay_s=0.008),)
    late = planned([DispersionKind.GUST], laws=("hinf-d1",), cases=2, scenario=replace(direct.scenario, link=faults))
    rows, others = flown(direct, runs=2), flown(late, runs=2)
    assert all(row["failure"] is None for row in others)
    assert all(row["rmse_deg"] != other["rmse_deg"] for row, other in zip(rows, others, strict=True))


def test_a_worker_of_another_version_refuses(planned):
    note = planned().metadata()
    note["versions"] = {**note["versions"], "numpy": "1.0"}
    with pytest.raises(ConfigError, match=r"a worker has other versions than the campaign: .*'numpy': '1\.0'"):
        fly_chunk(json.dumps(note), Chunk(0, 1))


LOSES_ITSELF = """
import numpy as np

class Loses:
    def __init__(self, vehicle):
        self.inertia = vehicle.inertia_B[0]
    def reset(self):
        self.angle = np.zeros(3)
    def step(self, gyro, reference, force, dt):
        self.angle += gyro * dt
        if self.inertia != 0.25 or gyro[0] > 2e-3:
            raise ValueError("lost")
        return -15.0 * self.angle - 3.0 * gyro
make = Loses
"""


def test_an_entry_flies_beside_laws_and_its_failures_are_results(planned, tmp_path):
    (tmp_path / "mine.py").write_text(LOSES_ITSELF)
    entry = parse_controller(f"{tmp_path}/mine.py:make")
    plan = planned(laws=("hinf-d1",), cases=12)
    campaign = replace(plan, laws=(*plan.laws, entry))
    rows = flown(campaign, first=12)
    failed = [row["failure"] is not None for row in rows]
    assert 0 < sum(failed) < 12
    assert {row["law"] for row in rows} == {"mine"}
    assert all("raised ValueError: lost (mine.py:12)" in row["failure"] for row in rows if row["failure"])
    assert [row["rmse_deg"] is None for row in rows] == failed
    again = CampaignRun(tmp_path / "mc.parquet", campaign, rows[failed.index(False)]).plan
    flight = fly_controller(
        again.scenario, again.controller, vehicle=again.vehicle, seed=again.seed, nominal=again.nominal
    )
    figures = measure(flight.records, again.vehicle, again.scenario)
    assert figures.rmse_deg == rows[failed.index(False)]["rmse_deg"]
    (tmp_path / "mine.py").write_text(LOSES_ITSELF + "\n")
    with pytest.raises(ConfigError, match=r"campaign: controller .* has changed"):
        trust(parse_campaign(campaign.metadata(), "campaign").laws[1])


@pytest.mark.parametrize(
    ("ends", "flown_times", "said"),
    [
        ([FlightOutcome.HUNG, FlightOutcome.DONE], 2, ""),
        ([FlightOutcome.KILLED, FlightOutcome.DONE], 2, ""),
        ([FlightOutcome.HUNG, FlightOutcome.KILLED], 2, "ended by SIGSEGV, for the second time"),
        ([FlightOutcome.PORT_TAKEN, FlightOutcome.DISARMED], 2, "ended by SIGSEGV, for the second time"),
        ([FlightOutcome.UNSETTLED], 1, "ended by SIGSEGV"),  # its loops are to blame
        ([FlightOutcome.DONE], 1, ""),
    ],
)
def test_a_real_autopilot_that_died_or_hung_is_replaced_once(planned, monkeypatch, ends, flown_times, said):
    plans, left = [], iter(ends)
    measured = worker._fly_bisecting(worker._make_simulator(planned(), load_law("pid-fair")), [CASE])[0]

    def fly(scenario, autopilot, *, vehicle, seed):
        plans.append((seed, vehicle.name))
        outcome, done = next(left), measured
        return SimpleNamespace(
            outcome=outcome, metrics=done.metrics, requirements=done.requirements, message="ended by SIGSEGV"
        )

    monkeypatch.setattr(worker, "fly_controller", fly)
    simulate = worker._make_simulator(planned(), ExternalAutopilot(kind="ardupilot"))
    assert worker._fly_bisecting(simulate, [CASE]) == [said or measured]
    assert len(plans) == flown_times
    assert set(plans) == {(5, "paper")}
