"""The one law form: file, step, discretisation, cascades, other formats."""
