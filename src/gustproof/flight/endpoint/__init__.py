"""The controller's process: fly a vehicle with a law file over MAVLink."""

DEFAULT_LAW = "flagship"
"""Name of the default law."""
