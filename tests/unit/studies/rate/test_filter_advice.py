from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.logs.identify.gyro_spectrum import GyroSpectrum, VibrationLine
from gustproof.studies.rate.filter_advice import best_choice, weigh_filters

VEHICLE = load_vehicle("iris")
AIR = load_scenario("paper-turbulence")
HERTZ = np.arange(1.0, 125.0)


def shaken(hertz, level):
    """Return the spectrum of a gyro with noise and one line [(rad/s)^2]."""
    density = np.full((3, len(HERTZ)), 1e-9)
    density[:, int(hertz) - 1] += level
    line = VibrationLine(hertz=hertz, height_db=30.0, share=0.9, moves=None)
    return GyroSpectrum(hertz=HERTZ, density=density, throttle=(), by_throttle=(), lines=(line,), is_raw=True)


@pytest.mark.parametrize(
    ("kind", "names"),
    [("px4", {"IMU_GYRO_NF0_FRQ", "IMU_GYRO_NF0_BW"}), ("ardupilot", {"INS_HNTCH_FREQ", "INS_HNTCH_ENABLE"})],
)
def test_a_notch_takes_a_line_away_and_its_phase_is_charged(kind, names):
    air = replace(AIR, control_rate_hz=400, physics_rate_hz=1200) if kind == "ardupilot" else AIR
    choices = weigh_filters(kind, {}, shaken(60.0, 0.02), VEHICLE, air)
    flown, notched = choices[0], next(each for each in choices if each.label == "notch at 60 Hz")
    assert names <= notched.changes.keys()
    assert max(notched.shaking) < 0.3 * max(flown.shaking)
    assert all(a >= b for a, b in zip(notched.Ms, flown.Ms, strict=True))
    assert all(a < b for a, b in zip(notched.delay_ms, flown.delay_ms, strict=True))
    opened = max((each for each in choices if each.label.startswith("low-pass")), key=lambda each: max(each.shaking))
    assert min(opened.delay_ms) > min(flown.delay_ms)


def test_the_best_filters_cost_no_margin_or_bring_some():
    loud = weigh_filters("px4", {}, shaken(60.0, 0.02), VEHICLE, AIR)
    best = best_choice(loud)
    assert best is not None
    assert "IMU_GYRO_NF0_FRQ" in best.changes
    assert max(best.shaking) < 0.95 * max(loud[0].shaking)
    assert all(a <= 1.01 * b for a, b in zip(best.Ms, loud[0].Ms, strict=True))
    quiet = weigh_filters("px4", {}, shaken(60.0, 1e-9), VEHICLE, AIR)
    opened = best_choice(quiet)
    assert opened is not None
    assert opened.changes == {"IMU_GYRO_CUTOFF": 80.0}
    assert min(opened.delay_ms) > min(quiet[0].delay_ms)


def test_a_notch_that_is_on_can_be_switched_off_and_filtered_gyros_are_not_weighed():
    on = {"IMU_GYRO_NF0_FRQ": 35.0, "IMU_GYRO_NF0_BW": 20.0}
    choices = weigh_filters("px4", on, shaken(60.0, 1e-9), VEHICLE, AIR)
    off = next(each for each in choices if each.label == "all notches off")
    assert off.changes == {"IMU_GYRO_NF0_FRQ": 0.0}
    assert min(off.delay_ms) > min(choices[0].delay_ms)
    assert weigh_filters("px4", on, replace(shaken(60.0, 1.0), is_raw=False), VEHICLE, AIR) == ()
    assert best_choice(()) is None


def test_an_unstable_loop_has_no_margins():
    choices = weigh_filters("px4", {"MC_ROLLRATE_P": 90.0}, shaken(60.0, 1e-9), VEHICLE, AIR)
    assert choices[0].Ms == ()
    assert best_choice(choices) is None
