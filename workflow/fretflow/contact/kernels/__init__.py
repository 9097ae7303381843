"""Compiled loops of the contact: sample, march, slope and sensitivity."""
