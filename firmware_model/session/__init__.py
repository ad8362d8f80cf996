"""Conduct a flight as a protocol core: pacing, lockstep, link faults, outcome."""
