"""Tune cascades: autotuned PID, fair PID, flagship, INDI."""
