"""How a flight ended, as the vehicle tells it."""

from enum import Enum


class VehicleOutcome(Enum):
    """How a flight ended."""

    DONE = "done"
    """Flown in OFFBOARD from beginning to end."""
    STREAM_LOST = "stream_lost"
    """The set-points stopped; the on-board loop flew to the end."""
    LEFT_OFFBOARD = "left_offboard"
    """Another mode was asked for; the on-board loop flew until OFFBOARD was asked for again, or to the end."""
    NO_CONTROLLER = "no_controller"
    """Nobody began the lockstep flight in time."""
    INTERRUPTED = "interrupted"
    """Ctrl-C or a termination signal."""
