"""Flight logs of autopilots and of our own, read into one form."""
