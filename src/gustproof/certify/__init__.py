"""What is true of a closed loop over its whole uncertainty: mu, worst cases, certificates; blind to how laws are made."""
