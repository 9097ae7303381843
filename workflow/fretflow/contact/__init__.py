"""The contact interface and the laws that act on it."""
