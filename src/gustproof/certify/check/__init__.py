"""Check certificates without a solver: in exact arithmetic, or in doubles with bounds of their rounding."""
