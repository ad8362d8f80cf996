"""Build uncertain systems as linear fractional transformations, and reduce them."""
