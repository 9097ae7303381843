"""Worn volumes of many tests."""
