import math

import pytest

from firmware_model.autopilot.guidance import Leg, NavigationState, is_reached, leg_target, plan_return


@pytest.mark.parametrize("home", [(0.0, 0.0, 0.0), (30.0, -40.0, -2.0)])
def test_the_way_home_is_up_across_and_down_and_over_home_down_alone(home):
    def plan(north, east, height):
        position = home[0] + north, home[1] + east, home[2] - height
        return plan_return(NavigationState(position, 0.0, 0.0, False), home, 10.0), position

    for height in (3.0, 15.0):
        level = home[2] - max(height, 10.0)
        over_home = home[0], home[1], level
        legs, (north, east, _) = plan(6.0, -8.0, height)
        assert legs == (Leg((north, east, level), False), Leg(over_home, False), Leg(over_home, True))
        assert plan(0.3, -0.3, height)[0] == (Leg(over_home, True),)


@pytest.mark.parametrize(("off", "reached"), [(math.nextafter(0.5, 0.0), True), (0.5, False)])
def test_below_half_a_metre_from_a_target_it_is_reached_but_that_of_a_descent_never_is(off, reached):
    for axis in range(3):
        near = NavigationState(tuple(off * (k == axis) for k in range(3)), 0.0, 0.0, False)
        assert is_reached(Leg((0.0, 0.0, 0.0), False), near) is reached
        assert not is_reached(Leg((0.0, 0.0, 0.0), True), near)
        assert len(plan_return(near, (0.0, 0.0, 0.0), 10.0)) == (1 if reached or axis == 2 else 3)


@pytest.mark.parametrize(
    ("height", "speed"), [(100.0, 1.5), (5.1, 1.5), (4.9, 1.47), (2.0, 0.6), (1.5, 0.5), (-1.0, 0.5)]
)
def test_a_descent_is_slower_near_the_height_of_home(height, speed):
    now, leg = NavigationState((3.0, 4.0, -30.0 - height), 0.0, 0.0, False), Leg((1.0, 2.0, -40.0), True)
    target = leg_target(leg, now, (5.0, 6.0, -30.0), 0.7, 0.5)
    assert target == (leg.position_N, 0.7, pytest.approx(speed))
    assert leg_target(leg._replace(descends=False), now, (5.0, 6.0, -30.0), 0.7, 0.5) == (leg.position_N, 0.7, None)
