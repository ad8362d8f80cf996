"""Controllers of the literature, tuned for a vehicle at a price; entries of the league."""
