"""What is true of a closed loop over its whole uncertainty: mu, worst cases, certificates; it never sees how a law was made."""
