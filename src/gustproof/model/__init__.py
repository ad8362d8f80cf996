"""Build design models: LFT, LPV airframe, weights, generalised plant."""
