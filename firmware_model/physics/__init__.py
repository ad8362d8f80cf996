"""Model airframe, actuators, rotors, air, ground and sensors."""
