"""Requirements in words: what is read, and what is refused by name."""

import math
from dataclasses import replace

import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.errors import ConfigError
from gustproof.flight.routes.batch import Case, make_batch_simulator
from gustproof.law.form import load_law
from gustproof.studies.wind_limit.kept import Kept, parse_keep, shares
from gustproof.studies.wind_limit.wind_flight import wind_scenario


def test_words_are_read_with_and_without_units() -> None:
    assert parse_keep("tilt<35, saturated < 1 %,yaw<4.5 deg") == (
        Kept("tilt", 35.0), Kept("saturated", 1.0), Kept("yaw", 4.5),
    )  # fmt: skip
    assert parse_keep("tilt<35")[0].text == "tilt < 35 deg"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no requirement such as"),
        ("tilt", "no requirement such as"),
        ("tilt<0", "no requirement such as"),
        ("tilt<1e", "no requirement such as"),
        ("tild<3", "did you mean 'tilt'"),
        ("tilt<3 m", "tilt is in deg, not in m"),
        ("drift<3 deg", "drift is in m, not in deg"),
        ("drift<3 m, error<1", "error is from set-points, which the position loop of drift moves"),
        ("tilt<3, tilt<4", "stands twice"),
    ],
)
def test_what_can_t_be_judged_is_refused(text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        parse_keep(text)


def test_shares_are_figures_over_limits_and_a_lost_flight_is_beyond_all() -> None:
    vehicle, base = load_vehicle("paper"), load_scenario("paper-turbulence")
    kept = parse_keep("tilt<20, error<0.5, saturated<1 %")
    script = wind_scenario(base, vehicle, kept, mean=12.0, turbulence=12.0, from_deg=90.0)
    assert script is not None
    (flown,) = make_batch_simulator(script, load_law("flagship"))([Case(vehicle=vehicle, seed=1)])
    tilt, error, saturated = shares(kept, flown)
    assert tilt == max(flown.metrics.peak_roll_deg, flown.metrics.peak_pitch_deg) / 20.0
    assert error == flown.requirements[0].value / 0.5
    assert saturated == flown.requirements[1].value / 0.6
    lost = replace(flown, metrics=replace(flown.metrics, peak_roll_deg=math.nan, peak_pitch_deg=math.nan))
    assert shares(kept, lost)[0] == math.inf
