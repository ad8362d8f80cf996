"""Define the one law form: its file, its step, discretisation, cascades, other formats."""
