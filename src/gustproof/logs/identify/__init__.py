"""Vehicle, air and sensors as a flight log shows them, each number with an interval."""
