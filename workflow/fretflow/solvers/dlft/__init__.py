"""Dynamic Lagrangian frequency-time method."""
