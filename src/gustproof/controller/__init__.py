"""The controller's process: a law file that flies a vehicle over MAVLink."""
