"""Predict error and slew in turbulence, and bound them for all laws."""
