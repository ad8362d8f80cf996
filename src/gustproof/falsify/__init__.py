"""Search for the disturbance that does most harm to a law."""
