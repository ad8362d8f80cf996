"""Where the autopilot's own modes fly to, as legs to straight targets: take-off, hold, return, landing.

No clock and no physics: a situation comes in, a target goes out. Heights are above home, where the vehicle stood when
it was armed.
"""

import math
from typing import NamedTuple

from firmware_model.types import PositionTarget, Vector

ACCEPTANCE_RADIUS_M = 0.5
"""[m] distance at which a target is reached."""
_MAX_DESCENT = 1.5  # [m/s]
_FLARE_GAIN = 0.3  # [1/s] descent per height, so that the ground is met at the landing speed however high it began


class NavigationState(NamedTuple):
    """What navigation tells the autopilot at a sample."""

    position_N: Vector
    """[m] N."""
    yaw: float
    """[rad] heading."""
    tilt: float
    """[rad] angle between the vehicle's vertical axis and the world's."""
    on_ground: bool
    """Whether the ground carries it."""


class Leg(NamedTuple):
    """One straight piece of a way."""

    position_N: Vector
    """[m] N, target; over it the vehicle sinks if `descends`."""
    descends: bool
    """Whether it ends on the ground."""


def plan_hold(now: NavigationState) -> tuple[Leg, ...]:
    """Return the way that ends where the vehicle is."""
    return (Leg(now.position_N, False),)


def plan_takeoff(now: NavigationState, home_N: Vector, height: float) -> tuple[Leg, ...]:
    """Return the way straight up to `height` [m]."""
    return (Leg((now.position_N[0], now.position_N[1], home_N[2] - height), False),)


def plan_landing(now: NavigationState) -> tuple[Leg, ...]:
    """Return the way straight down."""
    return (Leg(now.position_N, True),)


def plan_return(now: NavigationState, home_N: Vector, height: float) -> tuple[Leg, ...]:
    """Return the way home: up to `height` [m] or as high as it is, over home, down; straight down if it is there."""
    north, east, down = now.position_N
    level = min(down, home_N[2] - height)
    down_home = Leg((home_N[0], home_N[1], level), True)
    if math.hypot(north - home_N[0], east - home_N[1]) < ACCEPTANCE_RADIUS_M:
        return (down_home,)
    return Leg((north, east, level), False), Leg((home_N[0], home_N[1], level), False), down_home


def is_reached(leg: Leg, now: NavigationState) -> bool:
    """Whether the target of a leg is reached; that of a descent never is, the ground ends it."""
    return not leg.descends and math.dist(leg.position_N, now.position_N) < ACCEPTANCE_RADIUS_M


def leg_target(leg: Leg, now: NavigationState, home_N: Vector, yaw: float, land_speed: float) -> PositionTarget:
    """Return what is to be flown on a leg; a descent slows down to `land_speed` [m/s] near the ground."""
    if not leg.descends:
        return PositionTarget(leg.position_N, yaw, None)
    height = home_N[2] - now.position_N[2]
    return PositionTarget(leg.position_N, yaw, max(land_speed, min(_FLARE_GAIN * height, _MAX_DESCENT)))
