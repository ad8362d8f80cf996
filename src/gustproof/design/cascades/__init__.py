"""Tune cascades: autotuned PID, baseline PID, flagship, INDI."""
