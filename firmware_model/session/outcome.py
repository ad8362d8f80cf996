"""Outcome of a flight, as the vehicle reports it."""

from enum import Enum


class VehicleOutcome(Enum):
    """Outcome of a flight."""

    DONE = "done"
    """Flown in OFFBOARD from start to end."""
    STREAM_LOST = "stream_lost"
    """The set-points stopped; the on-board loop flew to the end."""
    LEFT_OFFBOARD = "left_offboard"
    """Another mode was requested; the on-board loop flew until OFFBOARD was requested again, or to the end."""
    NO_CONTROLLER = "no_controller"
    """No controller started the lockstep flight in time."""
    INTERRUPTED = "interrupted"
    """Ctrl-C or a termination signal."""
