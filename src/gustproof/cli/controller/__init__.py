"""The commands `gustproof controller`: fly a controller against an autopilot, or check how it keeps to the protocol."""
