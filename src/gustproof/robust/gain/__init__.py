"""Search for multipliers that prove an L2 gain."""
