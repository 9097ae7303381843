"""Periodic solutions: harmonic balance, DLFT and quasi-static contact."""
