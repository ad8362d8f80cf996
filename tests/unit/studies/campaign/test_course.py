"""The course: scenarios for any vehicle."""

import pytest

from firmware_model.config.vehicle import load_vehicle
from gustproof.studies.campaign.course import fit_scenario, load_course

PAPER = load_vehicle("paper")


@pytest.mark.parametrize(
    ("vehicle", "left_out"), [("paper", {"failed-rotor"}), ("iris", {"failed-rotor"}), ("octo", set())]
)
def test_a_scenario_that_leaves_no_hover_is_left_out(vehicle: str, left_out: set[str]) -> None:
    course, whole = load_course(load_vehicle(vehicle)), {each.name for each in load_course(load_vehicle("octo"))}
    assert len(whole) == 20
    assert whole - {each.name for each in course} == left_out
    assert not any(each.unflown for each in course)


def test_winds_turn_each_vehicle_alike_and_kicks_are_shares_of_its_torque() -> None:
    (kick,) = [each for each in load_course(PAPER) if each.name == "kick-all-axes"]
    iris = load_vehicle("iris")
    assert fit_scenario(kick, PAPER) == kick
    fitted = fit_scenario(kick, iris)
    assert fitted.gust_scale * iris.gust_gain / iris.inertia_B[0] == pytest.approx(
        kick.gust_scale * PAPER.gust_gain / PAPER.inertia_B[0]
    )
    assert fitted.moment[0].amplitude_nm == pytest.approx((1.5, -0.72, 0.14))
