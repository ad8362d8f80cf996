"""Compute the same bits on every route, with compiled arithmetic."""
