"""The controller's process: a law file that flies a vehicle over MAVLink."""

DEFAULT_LAW = "flagship"
"""Name of the law that is flown unless another is asked for."""
