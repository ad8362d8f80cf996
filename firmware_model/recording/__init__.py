"""Recordings of a flight, in files that survive a crash."""
