"""Flight logs: read them, identify a vehicle from them."""
