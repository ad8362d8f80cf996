"""Clients of the guide's page on the protocol; each runs as a program of its own."""
