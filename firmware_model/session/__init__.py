"""Conduct a flight without I/O: pacing, lockstep, link faults, outcome."""
