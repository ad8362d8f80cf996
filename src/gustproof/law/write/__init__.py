"""Write laws: MATLAB files, C, firmware."""
