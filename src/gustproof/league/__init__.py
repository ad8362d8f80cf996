"""The league: entries flown in the same seeds, at measured prices, and ranked with confidence."""
