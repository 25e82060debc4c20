"""Measurements from files: raw captures of boards, cubes, and the NumPy and MATLAB files that hold them."""
