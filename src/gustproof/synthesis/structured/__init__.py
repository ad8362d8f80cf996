"""Synthesise controllers of fixed structure by nonsmooth optimisation."""
