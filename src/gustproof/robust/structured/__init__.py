"""Synthesise controllers of fixed structure by non-smooth optimisation."""
