"""A live page on loopback: what a flight does while it is flown, and what a person may change in it."""
