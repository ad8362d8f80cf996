"""What holds for a closed loop over its whole uncertainty: mu, worst cases, certificates; blind to a law's making."""
