"""Serve a live page of a flight on loopback."""
