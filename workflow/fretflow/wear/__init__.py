"""Archard wear over millions of cycles by cycle jumps."""
