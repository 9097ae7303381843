"""Recordings of real joints: their format, readers, the cleaning of loops and what repeats say of the noise."""
