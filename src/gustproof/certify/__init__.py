"""Prove bounds on closed loops: gain, mu, boundedness; check certificates."""
