"""Certify the L2 gain of loops with real parameters that vary in time."""
