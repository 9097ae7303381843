"""Nonlinear modes of structures with friction joints: frequency and damping over amplitude."""
