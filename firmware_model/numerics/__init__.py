"""Compiled arithmetic that gives the same bits on every route."""
