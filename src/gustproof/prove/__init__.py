"""Prove what a law keeps on the airframe; the checker has the last word."""
