"""Search for the worst disturbance of a law."""
