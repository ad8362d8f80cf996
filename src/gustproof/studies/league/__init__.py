"""The league: controllers flown in the same seeds, at measured operating points, and ranked with confidence."""
