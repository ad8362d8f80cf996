"""Fly laws: directly, in batches, over loopback, over UDP."""
