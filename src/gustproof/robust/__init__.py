"""Robust control without flight: linear systems, LFTs, synthesis, structured values, certified gains."""
