"""Simulate the vehicle's side of the UDP socket: airframe, air, sensors, autopilot, MAVLink."""
