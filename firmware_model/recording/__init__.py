"""Append what a flight records to files that survive a crash."""
