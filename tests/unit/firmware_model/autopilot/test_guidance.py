import pytest

from firmware_model.autopilot.guidance import Leg, NavigationState, plan_return


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
