"""Analyse a law on a vehicle: margins, robustness, limits, responses."""
