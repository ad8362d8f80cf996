"""Control and guide the vehicle on board: modes, loops, gains, parameters."""
