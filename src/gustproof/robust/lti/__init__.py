"""Analyse linear systems: state space, norms, margins, Riccati equations, exact rationals."""
