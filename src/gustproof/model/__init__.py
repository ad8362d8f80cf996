"""Design models: the paper's parameter-varying airframe, weights, and the generalised plant as a labelled diagram."""
