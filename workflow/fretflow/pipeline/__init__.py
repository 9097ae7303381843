"""The stages of a run: thin adapters between files and computation."""
