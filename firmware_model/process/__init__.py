"""Sockets, clock and process: UDP loop, access control, real-time hints, logs."""
