"""Structures with friction joints: frequency and damping over amplitude, ring-downs, responses under control."""
