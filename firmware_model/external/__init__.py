"""Host a real autopilot: simulate its vehicle and its sensors for it."""
