"""Mu-synthesis by D-G-K iteration, and covers of a family of models by one model and a weight."""
