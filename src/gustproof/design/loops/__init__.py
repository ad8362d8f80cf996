"""Attitude and rate loops of PX4 and ArduPilot as laws of the one form, from their parameter files."""
