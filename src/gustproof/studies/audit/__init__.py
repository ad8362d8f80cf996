"""Audit a simulator of others: the deterministic tests that our own passes, as a table."""
