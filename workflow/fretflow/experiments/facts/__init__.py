"""Scalar facts of tests."""
