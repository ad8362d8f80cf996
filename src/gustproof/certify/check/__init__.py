"""Check certificates in exact arithmetic, with the standard library only."""
