import math

import pytest

from firmware_model.autopilot.gains import POSITION_GAINS, replace_gains, stabilizer_gains
from firmware_model.config.vehicle import list_vehicles, load_vehicle


@pytest.mark.parametrize("name", list_vehicles())
def test_shipped_gains_are_within_their_ranges_and_change_no_bit_when_nothing_is_set(name):
    vehicle = load_vehicle(name)
    for gains, loop in ((stabilizer_gains(vehicle), vehicle.stabilizer), (POSITION_GAINS, vehicle.position)):
        assert all(gain.minimum <= gain.display_value(loop) <= gain.maximum for gain in gains.values())
        assert replace_gains(loop, gains, {}) == loop


def test_rate_gain_is_told_as_a_part_of_the_largest_torque():
    vehicle = load_vehicle("paper")
    gains = stabilizer_gains(vehicle)
    assert gains["MC_ROLLRATE_P"].display_value(vehicle.stabilizer) == pytest.approx(14.0 * 0.25 / 10.0)
    assert gains["MC_YAWRATE_D"].display_value(vehicle.stabilizer) == pytest.approx(0.8 * 0.1 / 10.0)


def test_changed_gain_alone_is_another():
    vehicle = load_vehicle("paper")
    loop = replace_gains(vehicle.stabilizer, stabilizer_gains(vehicle), {"MC_PITCHRATE_P": 0.5, "GP_RATE_MAX": 90.0})
    assert loop.rate_p == (14.0, pytest.approx(0.5 * 10.0 / 0.2), 14.0)
    assert loop.rate_limit == pytest.approx(math.pi / 2)
    assert loop.rate_i == vehicle.stabilizer.rate_i


def test_every_end_of_every_range_is_a_vehicle():
    vehicle = load_vehicle("iris")
    for gains, loop in ((stabilizer_gains(vehicle), vehicle.stabilizer), (POSITION_GAINS, vehicle.position)):
        for name, gain in gains.items():
            for end in (gain.minimum, gain.maximum):
                assert gain.display_value(replace_gains(loop, gains, {name: end})) == pytest.approx(end)
