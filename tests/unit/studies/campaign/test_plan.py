import json
from dataclasses import replace
from types import SimpleNamespace

import pytest

from firmware_model.config.uncertainty import VehicleSet, load_vehicle_set
from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from gustproof.flight.controllers.user_controller import parse_controller
from gustproof.law.form import load_law
from gustproof.studies.campaign.plan import DispersionKind, confirm, parse_campaign, select_spreads, usual_dispersions


def test_the_nominal_case_is_the_scenario_with_its_vehicle(planned):
    campaign = planned()
    case = campaign.make_case([0.0] * len(campaign.spreads), 7)
    assert case.vehicle == load_vehicle("paper")
    assert case.apply_to(campaign.scenario) == campaign.scenario


def test_the_edges_are_what_the_files_and_options_say(planned):
    campaign = planned()
    case = campaign.make_case([1.0] * len(campaign.spreads), 7)
    assert case.vehicle.inertia_B == (0.3, 0.24, 0.12)
    assert case.vehicle.gyro.snr_db == 38.0
    assert case.gust_scale == 1.5
    assert case.initial_attitude_deg == (2.0, 2.0, 2.0)


def test_a_case_that_no_flight_begins_with_is_told_in_a_line(planned):
    scenario = replace(planned().scenario, initial_attitude_deg=(0.0, 0.0, 179.0))
    campaign = planned([DispersionKind.ATTITUDE], scenario=scenario)
    assert campaign.make_case([0.0, 0.0, 0.4], 7).initial_attitude_deg == (0.0, 0.0, 179.8)
    with pytest.raises(ConfigError, match=r"^case: initial_attitude_deg\.2: .*less than or equal to 180 \(given 181"):
        campaign.make_case([0.0, 0.0, 1.0], 7)


def test_only_what_is_wanted_is_drawn(planned):
    assert list(planned([DispersionKind.GYRO]).spreads) == [
        "gyro.snr_db", "gyro.bias_B.x", "gyro.bias_B.y", "gyro.bias_B.z",
    ]  # fmt: skip
    assert list(planned([DispersionKind.GUST]).spreads) == ["gust_scale"]
    assert planned([DispersionKind.GUST]).make_case([0.4], 7).vehicle == load_vehicle("paper")


def test_by_default_is_drawn_what_the_vehicle_file_has():
    paper, kinds = load_vehicle_set("paper"), DispersionKind
    gyro = {name: spread for name, spread in paper.spreads.items() if name.startswith("gyro.")}
    body = {name: spread for name, spread in paper.spreads.items() if name not in gyro}
    assert usual_dispersions(paper) == [kinds.VEHICLE, kinds.GUST, kinds.GYRO]
    assert usual_dispersions(SimpleNamespace(spreads=body)) == [kinds.VEHICLE, kinds.GUST]
    assert usual_dispersions(SimpleNamespace(spreads=gyro)) == [kinds.GUST, kinds.GYRO]
    assert usual_dispersions(SimpleNamespace(spreads={})) == [kinds.GUST]


def test_a_campaign_is_read_back_from_its_note(planned):
    campaign = planned()
    note = json.loads(json.dumps(campaign.metadata()))
    again = parse_campaign(note, "note")
    assert again.metadata() == campaign.metadata()
    assert again.scenario == campaign.scenario
    assert again.make_case(again.draw_deltas(3, 1)[0], 7) == campaign.make_case(campaign.draw_deltas(3, 1)[0], 7)


@pytest.mark.parametrize("note", [None, {}, {"format": "gustproof-campaign-1"}, {"format": "another"}])
def test_what_is_no_note_is_told_in_a_line(note):
    with pytest.raises(ConfigError, match=r"^mc\.parquet: "):
        parse_campaign(note, "mc.parquet")


def test_an_entry_of_a_file_flies_as_the_given_one_of_its_name():
    given = [parse_controller("exec: true a"), load_law("hinf-d1"), replace(parse_controller("exec: true b"), name="c")]
    stored = replace(parse_controller("exec: true b"), name="c", given=False)
    assert confirm(stored, given, "mc.parquet") == given[2]
    with pytest.raises(ConfigError, match=r"^mc\.parquet: flown by"):
        confirm(replace(stored, name=given[0].name), given, "mc.parquet")


def test_laws_must_differ_in_name_and_step_with_the_scenario(planned):
    with pytest.raises(ConfigError, match="law 'hinf-d1': given 2 times"):
        planned(laws=("hinf-d1", "hinf-d1"))


def test_a_vehicle_without_spreads_says_how_to_give_them(planned):
    document = load_vehicle_set("paper").document
    plain = VehicleSet(document={**document, "actuator_lag": 0.05, "inertia_B": [0.25, 0.2, 0.1]})
    with pytest.raises(ConfigError, match=r"vehicle 'paper' has no spread .*actuator_lag as \{ nominal"):
        select_spreads(plain, planned().scenario, [DispersionKind.VEHICLE], gust=0.5, attitude_deg=2.0)
