"""Judge by name what a controller does over MAVLink."""
