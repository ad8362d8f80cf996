"""Write folders with a law inside real autopilots: what they build, and how to fly it."""
