"""Readers of files: delimited text, MATLAB, HDF5."""
