"""Readers of files, one file a form: delimited text, MATLAB, HDF5; see `tables.Reader`."""
