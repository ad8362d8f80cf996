"""Predict error and slew in turbulence, and the limits no law can beat."""
