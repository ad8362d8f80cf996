"""The vehicle as a linear model, and what it predicts: errors, slew, limits that hold for all laws."""
