"""Bound mu and the worst-case gain of loops with constant uncertainty; prove stability over boxes of parameters."""
