"""Read and write laws in other formats: C, MATLAB, CSV."""
