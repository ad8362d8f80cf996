"""Laws for other tools: C code, MATLAB and SciPy files, tables of numbers."""
