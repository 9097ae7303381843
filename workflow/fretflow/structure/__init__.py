"""Structures that a friction joint is part of: finite elements, reduction, the two-mass rig, matrices."""
