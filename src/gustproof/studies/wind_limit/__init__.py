"""The wind that a vehicle stands with a law: in turbulence, in single gusts, and proved."""
