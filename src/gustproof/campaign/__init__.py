"""Campaigns: one scenario flown many times with what is uncertain drawn anew, on many cores, and what comes of it."""
