"""Read and validate vehicle, scenario and wind files."""
