"""The commands `gustproof identify`: a vehicle from the log of a flight, or rate loops from a flight now."""
