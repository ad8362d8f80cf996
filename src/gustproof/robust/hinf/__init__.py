"""Synthesise H-infinity controllers by two Riccati equations."""
