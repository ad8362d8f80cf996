"""Design laws for a vehicle."""
