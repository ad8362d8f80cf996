"""Controllers that users bring: Python objects, C libraries, and programs that speak MAVLink."""
