"""Host a real autopilot as a guest: simulate its vehicle and its sensors for it."""
