"""The commands `gustproof campaign`: one scenario flown many times, a rare event, and one run again."""
