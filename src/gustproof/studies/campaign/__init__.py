"""Fly one scenario thousands of times and draw statistics from it."""
