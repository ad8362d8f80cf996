"""Linear controllers of the literature, tuned for a vehicle."""
