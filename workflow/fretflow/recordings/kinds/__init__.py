"""Kinds of recordings that are read by a file of their own."""
