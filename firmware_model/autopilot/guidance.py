"""Plan the autopilot's own modes as legs to straight targets: take-off, hold, return, landing.

No clock and no physics: a navigation state comes in, a target goes out. Heights are above home, the position at arming.
"""

import math
from typing import NamedTuple

from firmware_model.types import PositionTarget, Vector

ACCEPTANCE_RADIUS_M = 0.5
"""[m] distance within which a target is reached."""
_MAX_DESCENT = 1.5  # [m/s]
_FLARE_GAIN = 0.3  # [1/s] descent per height: any descent meets the ground at the landing speed


class NavigationState(NamedTuple):
    """Ideal navigation at a sample."""

    position_N: Vector
    """[m] N."""
    yaw: float
    """[rad] heading."""
    tilt: float
    """[rad] angle between the vehicle's vertical axis and the world's."""
    on_ground: bool
    """True if the ground carries the vehicle."""


class Leg(NamedTuple):
    """One straight piece of a path."""

    position_N: Vector
    """[m] N, target; a leg that `descends` sinks over it, below its height."""
    descends: bool
    """True if it ends on the ground."""


def plan_hold(now: NavigationState) -> tuple[Leg, ...]:
    """Return the leg that holds the present position."""
    return (Leg(now.position_N, False),)


def plan_takeoff(now: NavigationState, home_N: Vector, height: float) -> tuple[Leg, ...]:
    """Return the leg straight up to `height` [m]."""
    return (Leg((now.position_N[0], now.position_N[1], home_N[2] - height), False),)


def plan_landing(now: NavigationState) -> tuple[Leg, ...]:
    """Return the leg straight down."""
    return (Leg(now.position_N, True),)


def plan_return(now: NavigationState, home_N: Vector, height: float) -> tuple[Leg, ...]:
    """Return the legs home: up to at least `height` [m], across, down; over home only the descent."""
    north, east, down = now.position_N
    level = min(down, home_N[2] - height)
    down_home = Leg((home_N[0], home_N[1], level), True)
    if math.hypot(north - home_N[0], east - home_N[1]) < ACCEPTANCE_RADIUS_M:
        return (down_home,)
    return Leg((north, east, level), False), Leg((home_N[0], home_N[1], level), False), down_home


def is_reached(leg: Leg, now: NavigationState) -> bool:
    """Return whether the target of a leg is reached; that of a descent never is, because the ground ends it."""
    return not leg.descends and math.dist(leg.position_N, now.position_N) < ACCEPTANCE_RADIUS_M


def leg_target(leg: Leg, now: NavigationState, home_N: Vector, yaw: float, land_speed: float) -> PositionTarget:
    """Return the position target of a leg; a descent slows down to `land_speed` [m/s] near the ground."""
    if not leg.descends:
        return PositionTarget(leg.position_N, yaw, None)
    height = home_N[2] - now.position_N[2]
    return PositionTarget(leg.position_N, yaw, max(land_speed, min(_FLARE_GAIN * height, _MAX_DESCENT)))
