"""Synthesis of scheduled controllers for plants that depend on measured parameters."""
