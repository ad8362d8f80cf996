"""Measure flights: one record of figures, and requirements with their margins."""
