"""Studies of laws: rate them, fly campaigns, attack them, compare many, audit simulators."""
