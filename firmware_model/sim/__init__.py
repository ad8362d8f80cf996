"""Step the simulated world: state, sample step, inner loop, faults."""
