"""Numbers in which autopilots differ over MAVLink."""

from typing import NamedTuple


class Dialect(NamedTuple):
    """Numbers in which autopilots differ over MAVLink."""

    autopilot: int
    """MAV_AUTOPILOT."""
    mode_name: str
    """Mode that follows attitude set-points, as its users call it."""
    mode: tuple[float, float]
    """[-] parameters 2 and 3 of MAV_CMD_DO_SET_MODE for that mode."""
    custom_mode: int
    """The mode in its heartbeat."""
    array_name: str = ""
    """Name of the array that carries attitude and thrust to a law inside; empty for attitude targets."""
    thrust_range: tuple[float, float] = (0.0, 1.0)
    """[-] thrust at the least and at the largest thrust command, as a fraction of the rotors' largest."""
    law_switch: tuple[float, ...] = ()
    """[-] MAV_CMD and its parameters that give control to a law inside; empty if there is none, or the mode does."""
    law_is_on: str = ""
    """Text that tells of it."""
    fix_switches: tuple[tuple[str, float, float], ...] = ()
    """[-] parameters of the fix of a receiver that it simulates itself, each with its value with a fix and without."""
