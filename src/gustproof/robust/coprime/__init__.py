"""Synthesis and distances by normalised coprime factors: loop shaping and the gap metrics."""
