"""Reproduction of the paper: flights, verdicts on its claims, its errata."""
